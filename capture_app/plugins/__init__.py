"""Plugins, which nothing imports: cameras, programs and footage, found by their entry points."""
