"""Speed and accuracy, measured: most files are commands (`python -m benchmarks.clock.sync_link --help`)."""
