"""A session for reconstruction: its images, instants, conditions and moving regions."""
