"""The command `multiview`: depth, cloud and mesh of an instant from all cameras, and its scores.

Imports `depth`, `scores`, `calibration`, `session` and `common`.
"""
