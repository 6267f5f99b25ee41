"""Calibration by pictures of a board: each lens, then where the cameras stand, then all together."""
