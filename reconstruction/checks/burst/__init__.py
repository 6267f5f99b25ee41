"""The burst as a grid of small pictures."""
