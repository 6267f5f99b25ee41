"""The mode Shoot: what the cameras see, the take, and seconds later whether it was good.

May import `widgets` beside the files of `tui` itself, and no other mode.
"""
