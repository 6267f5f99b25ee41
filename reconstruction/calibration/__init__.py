"""Where cameras stand and how they see, from a board, from what stands still, or from a file.

Imports `session` and `common`.
"""
