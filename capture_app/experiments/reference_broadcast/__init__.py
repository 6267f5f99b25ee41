"""Clients that hear the same packets, beside the same clients without."""
