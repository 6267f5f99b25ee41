"""Simulations for benchmarks and tests only: aligners frame by frame, trees of clocks, more link laws."""
