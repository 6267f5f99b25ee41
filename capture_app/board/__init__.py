"""The ChArUco board that calibrates a rig: its shape, its printed page, its detection and coverage.

Both packages use it, as they do `text` and `errors`: the capture side while the board is held, the
reconstruction for what was recorded of it. Imports `errors` only.
"""
