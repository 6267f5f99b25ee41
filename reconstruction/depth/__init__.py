"""Depth from many views: plane sweep, consistency check, fusion, mesh. Arrays in, arrays out."""
