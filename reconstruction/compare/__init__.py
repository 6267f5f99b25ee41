"""Comparison of synchronized with offset frames: the same studies under both conditions."""
