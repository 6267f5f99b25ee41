"""Scenes by name: their cameras and how things move in them; knows no camera model.

What stands in them is in `files`, as `python -m benchmarks.scenery` makes it.
"""
