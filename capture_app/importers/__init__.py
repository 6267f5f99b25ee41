"""Importers: a module for each program whose recordings or calibrations are read, found by entry points."""
