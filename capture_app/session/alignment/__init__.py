"""Alignment of unsynchronized recordings: offsets and rates from sound, flashes and camera metadata."""
