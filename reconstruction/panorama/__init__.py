"""Pictures of several cameras stitched into one, by OpenCV's Stitcher or by one homography a pair.

Imports `stereo`, `calibration`, `session` and `common`.
"""
