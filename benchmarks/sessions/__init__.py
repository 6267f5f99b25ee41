"""Cost of a burst on its path to the disk."""
