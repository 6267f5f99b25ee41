"""Depth from many views: plane sweep, PatchMatch, consistency, fusion, mesh.

Arrays in, arrays out: imports `common` alone.
"""
