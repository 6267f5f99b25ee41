"""The session on disk: the only bridge between capture and everything after it."""
