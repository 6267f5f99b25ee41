"""Access to a running rig: start or join it, watch it, take pictures with it, operate and measure it."""
