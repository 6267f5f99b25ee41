"""Import of recordings: importer interface, image sources, times, alignment, calibrations."""
