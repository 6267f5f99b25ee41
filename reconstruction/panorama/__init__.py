"""The command `stitch`: a panorama by OpenCV's stitcher, or of a registered pair for comparisons.

Imports `pairs`, `scores`, `session` and `common`.
"""
