"""Depth from a stereo pair by rectification and semi-global matching."""
