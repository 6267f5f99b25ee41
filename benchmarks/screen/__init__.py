"""What the terminal UI costs: processor time, bytes to the terminal, and what the rig notices of it."""
