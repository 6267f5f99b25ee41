"""Calibrations of OpenCV's and MATLAB's users."""
