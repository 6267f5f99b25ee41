"""Import of recordings: what an importer states, image sources, times, alignment, calibrations."""
