"""State of a rig after a long time, or after many bursts."""
