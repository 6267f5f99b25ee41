"""Sensors, clocks and scenes that behave as real ones do, for nodes without a camera and for tests."""
