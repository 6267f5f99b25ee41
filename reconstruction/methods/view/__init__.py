"""Views of a moment from places without a camera; the study goes from camera to camera."""
