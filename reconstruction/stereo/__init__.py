"""Depth from a pair: rectification, matching, the command.

Imports `calibration`, `session` and `common`.
"""
