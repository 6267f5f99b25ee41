"""Formats of joints in images and of people in 3D: a module each, found by its entry point."""
