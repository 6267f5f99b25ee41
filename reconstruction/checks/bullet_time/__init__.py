"""One instant from camera to camera."""
