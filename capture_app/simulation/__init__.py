"""Simulated cameras, sensors and network links, with rendered images."""
