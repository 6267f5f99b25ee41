"""Simulated scenes by name: their cameras and their moving bodies."""
