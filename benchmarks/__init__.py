"""Speed and accuracy benchmarks; most files are commands (`python -m benchmarks.clock.sync_link --help`)."""
