"""The command `stitch` and the one engine of panoramas, that of comparisons too.

Imports `pairs`, `scores`, `session` and `common`.
"""
