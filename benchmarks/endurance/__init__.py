"""What a rig is like after a long time, or after many bursts."""
