"""Webcams by OpenCV, on systems whose own camera interface there is no driver for: the lowest grade."""
