"""Layouts of trainers of Gaussian splats, with COLMAP models and glTF cameras."""
