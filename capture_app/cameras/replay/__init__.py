"""Recordings, sessions or videos, replayed as live cameras."""
