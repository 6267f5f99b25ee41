"""Depth maps, point cloud and mesh of an instant from all cameras."""
