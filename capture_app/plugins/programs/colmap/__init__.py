"""COLMAP: its cameras and models, read and written."""
