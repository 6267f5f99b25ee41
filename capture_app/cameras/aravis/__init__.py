"""GigE Vision and USB3 Vision cameras, by the system's aravis library."""
