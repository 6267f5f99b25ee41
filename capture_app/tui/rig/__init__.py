"""The mode Rig: every camera with its clock and phase over time, whether the rig is ready, and what happened.

May import `widgets` beside the files of `tui` itself, and no other mode.
"""
