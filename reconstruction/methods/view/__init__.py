"""Views of a moment from places without a camera."""
