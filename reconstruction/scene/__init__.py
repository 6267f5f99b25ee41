"""Sessions as input for reconstruction: images, instants, conditions and moving regions."""
