"""Replay: a session or a video as a live camera."""
