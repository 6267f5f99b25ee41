"""Jobs: commands that the screen runs on sessions, one at a time, and their results."""
