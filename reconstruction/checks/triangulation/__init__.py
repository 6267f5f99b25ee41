"""COLMAP's points on moving and still objects."""
