"""Reports of comparisons: one HTML page each, from templates."""
