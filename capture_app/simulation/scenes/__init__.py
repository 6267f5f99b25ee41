"""What can be filmed: the scenes by name, their bodies, how they move, what is printed on them.

Geometry, colours and motion alone; knows no camera model.
"""
