"""Basics for all rooms: errors, names, text, clocks, addresses, camera facts and node states."""
