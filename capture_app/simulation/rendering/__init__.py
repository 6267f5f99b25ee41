"""Images of a scene as a rolling-shutter camera sees them."""
