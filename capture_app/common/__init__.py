"""What every room may use: errors, names, text, clocks, addresses, facts of cameras and states of nodes."""
