"""One moment seen from camera to camera: the steady ride round it, and the grid of a burst.

Imports `report`, `scores`, `calibration`, `session` and `common`.
"""
