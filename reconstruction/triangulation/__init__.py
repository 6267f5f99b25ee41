"""Single points that COLMAP finds in several pictures and places by known poses; no command of its own.

Imports `session` and `common`.
"""
