"""Widgets shared by the modes: lines, plots, images, contact sheets."""
