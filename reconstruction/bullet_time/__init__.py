"""One moment seen from camera to camera: the stabilized sweep, and the grid of a burst; no command.

Imports `report`, `scores`, `calibration`, `session` and `common`.
"""
