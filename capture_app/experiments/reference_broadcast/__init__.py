"""How far apart clients' clocks are, with the reference broadcast and without."""
