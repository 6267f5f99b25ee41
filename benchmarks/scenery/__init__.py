"""The painter of the simulated scenes: shapes, materials and prints of all that stands and moves in them."""
