"""Camera poses of single instants, compared with the calibration."""
