"""What only benchmarks and tests simulate: aligners frame by frame, trees of clocks, more laws of links."""
