"""What a user measures on his own rig: a camera, how late its stamps are, the clock over his link."""
