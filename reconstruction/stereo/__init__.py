"""The command `stereo`: depth from a pair by rectification and semi-global matching.

Imports `scores`, `calibration`, `pairs`, `session` and `common`.
"""
