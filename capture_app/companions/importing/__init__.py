"""Import of recordings: what a folder holds, its times, their alignment, and the sessions written."""
