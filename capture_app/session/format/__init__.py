"""What a session's files mean: manifest, plan, journal, calibration, ground truth, and their checks.

Imports `files`; reads and writes no folder by itself.
"""
