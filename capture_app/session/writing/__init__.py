"""Writing a session image by image, completing it, and recovering it after a crash.

Imports `reading`, `format` and `files`.
"""
