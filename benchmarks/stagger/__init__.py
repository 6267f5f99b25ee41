"""Staggered rigs beside rigs in step: errors of their frames, and the path of a ball."""
