"""LED and screen panels that display the time: their pattern, detection, and time as read from images."""
