"""Panoramas of one instant, stitched from all cameras."""
