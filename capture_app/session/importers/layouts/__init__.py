"""Folders of other programs, recognized by the names that those programs give their files."""
