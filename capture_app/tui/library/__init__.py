"""The mode Sessions: what is on disk, looked at, named, sent on to commands and to other programs.

May import `jobs` and `widgets` beside the files of `tui` itself, and no other mode.
"""
