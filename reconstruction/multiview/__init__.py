"""The command `multiview`: depth, cloud and mesh of an instant from all cameras, held against the truth.

Imports `depth`, `scores`, `stereo`, `calibration`, `session` and `common`.
"""
