"""A session written image by image, finished, and recovered after a crash.

Imports `reading`, `format` and `files`.
"""
