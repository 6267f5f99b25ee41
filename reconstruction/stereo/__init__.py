"""The command `stereo`: depth from a pair by rectification and semi-global matching.

Imports `scores`, `calibration`, `session` and `common`.
"""
