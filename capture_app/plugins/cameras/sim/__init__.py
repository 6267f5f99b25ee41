"""Simulated cameras and sensors, with rendered images."""
