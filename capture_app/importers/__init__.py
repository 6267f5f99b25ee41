"""Plugins that import recordings and calibrations: a module for each program."""
