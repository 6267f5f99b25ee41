"""Painter of the simulated scenes: shapes, materials and prints of all objects in them."""
