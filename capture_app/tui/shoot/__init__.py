"""The mode Shoot: what the cameras see, the take, and seconds later whether it was good.

May import `viewfinder`, `sheets`, `pictures` and `drawing` beside the files of `tui` itself, no other mode.
"""
