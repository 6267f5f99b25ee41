"""Importers: recordings of other programs become sessions."""
