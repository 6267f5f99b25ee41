"""Plugins that export a session: a module for each format."""
