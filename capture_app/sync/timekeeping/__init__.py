"""Timekeeping of a client: when to send time requests, and how good the clock is."""
