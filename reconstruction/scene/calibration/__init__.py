"""Calibration of a rig from a board, from motion or from a file."""
