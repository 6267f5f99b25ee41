"""The world that a calibration is in: its scale, where the ground is and which way is up."""
