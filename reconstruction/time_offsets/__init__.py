"""Time offsets between cameras, measured from motion in their images."""
