"""Sound of a camera's microphone, stored within the camera's JPEG images."""
