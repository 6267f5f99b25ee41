"""Importer interface, image sources, frames matched in time, calibrations of other programs."""
