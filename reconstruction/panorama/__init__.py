"""The command `panorama` and the one engine of panoramas, that of comparisons too.

Imports `pairs`, `scores`, `session` and `common`.
"""
