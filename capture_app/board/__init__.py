"""Calibration boards: their pattern, printed page, detection, and the coverage of the images."""
