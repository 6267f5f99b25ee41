"""The cameras' poses, found from the pictures of single instants, and their errors; no command of its own.

Imports `session` and `common`.
"""
