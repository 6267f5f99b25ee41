"""Reconstruct recorded sessions and compare synchronized with offset frames."""
