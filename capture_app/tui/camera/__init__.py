"""One camera closely: how its clock and phase are known, what it says, and what it sees.

May import `drawing` and `pictures` beside the files of `tui` itself, and no mode.
"""
