"""The command `calibrate`, the rig and its calibration: from a board, from motion or from a file.

Imports `session`, `pairs` and `common`.
"""
