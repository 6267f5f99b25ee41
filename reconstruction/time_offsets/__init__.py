"""How late one camera's pictures are against another's, measured from what moves in them.

Imports `session`, `calibration`, `pairs` and `common`.
"""
