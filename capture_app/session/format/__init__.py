"""Contents of a session's files: manifest, burst plan, journal, calibration, ground truth."""
