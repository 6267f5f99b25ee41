"""Calibrations of other programs: each format in a file, read into `Views` and fitted to a recording."""
