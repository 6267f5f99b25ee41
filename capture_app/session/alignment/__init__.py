"""How the times of cameras that were never synchronized go together, measured from their recordings.

Imports `format`; opens recordings, and writes nothing.
"""
