"""The first minute: what can take pictures here, each a key away; and adding cameras later.

May import `drawing` beside the files of `tui` itself, and no mode.
"""
