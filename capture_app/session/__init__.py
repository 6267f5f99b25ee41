"""Sessions on disk, the only bridge from capture to reconstruction."""
