"""Cameras of libcamera, such as the Raspberry Pi's, through the system's Python bindings."""
