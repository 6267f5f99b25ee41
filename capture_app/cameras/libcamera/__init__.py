"""Cameras of libcamera, those of the Raspberry Pi first, by the system's own Python bindings."""
