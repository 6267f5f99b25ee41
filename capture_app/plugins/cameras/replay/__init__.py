"""Recordings, that is sessions or videos, replayed as live cameras."""
