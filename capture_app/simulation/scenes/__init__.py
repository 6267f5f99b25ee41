"""Scenes by name: geometry, colours, prints and motion alone; knows no camera model."""
