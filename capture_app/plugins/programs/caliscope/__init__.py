"""Caliscope: its recordings and calibrations, read and written."""
