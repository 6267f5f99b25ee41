"""Pages for devices in the hand: served over TLS, each device admitted by a QR code."""
