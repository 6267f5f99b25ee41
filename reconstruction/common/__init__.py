"""What every command shares: geometry, brightness, image files, drawing, stage cache, native libraries.

The ground of `reconstruction`: imports no other wing.
"""
