"""Depth from many views: plane sweep, consistency check, fusion, mesh. Takes and returns arrays."""
