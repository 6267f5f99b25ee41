"""Exporters: a module for each format that sessions are exported to, found by entry points."""
