"""What is measured on a result, with its uncertainty, and how it is told in `metrics.json`.

Imports `stereo` (a depth map's shape), `session` and `common`.
"""
