"""A session for reconstruction: its images, instants, offset conditions and movers.

Imports `common`; the only wing that opens sessions.
"""
