"""The mode Sessions: what is on disk, looked at, named, sent on to jobs and to other programs.

May import `jobs`, `sheets`, `pictures` and `drawing` beside the files of `tui` itself, and no other mode.
"""
