"""Webcams on Windows, macOS and Linux through OpenCV, which chooses the system's own camera interface."""
