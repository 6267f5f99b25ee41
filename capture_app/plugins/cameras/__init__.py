"""Camera drivers, a folder or module each."""
