"""Alignment of unsynchronized recordings: the interface of its methods, and a camera's line of times."""
