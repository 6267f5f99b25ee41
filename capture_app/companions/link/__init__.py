"""Measurement of clock synchronization over a real or a recorded link."""
