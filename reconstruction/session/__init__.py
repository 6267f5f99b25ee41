"""A session as reconstruction sees it: images, instants, offset conditions, what moves.

Imports `common`; the only wing that opens sessions.
"""
