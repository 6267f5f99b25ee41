"""A session opened, verified and summed up; never changed.

Imports `format` and `files`.
"""
