"""Camera drivers behind one interface; a backend is imported on first use."""
