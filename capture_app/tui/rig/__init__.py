"""The mode Rig: every camera with its clock and phase over time, whether the rig is ready, and what happened.

May import `drawing`, `start` and `camera` beside the files of `tui` itself, and no other mode.
"""
