"""The command `calibrate`, the rig, its calibration (from a board, from motion or from a file) and its pairs.

Imports `session` and `common`.
"""
