"""What the cameras see now: all of them side by side, one full size with aids, two blinked at one instant.

May import `pictures` and `drawing` beside the files of `tui` itself.
"""
