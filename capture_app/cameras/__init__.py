"""Camera drivers behind one interface; a backend is imported when it is asked for."""
