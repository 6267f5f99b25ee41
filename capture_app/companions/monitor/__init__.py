"""Director's monitor: a page for a phone or tablet with the live pictures of a rig and its take button."""

DEFAULT_PORT = 47012
"""TCP port of the page."""
