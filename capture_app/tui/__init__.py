"""The terminal UI: renders status snapshots and posts what the user asked for."""
