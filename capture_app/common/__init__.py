"""Basics for every room: errors, names, text, clocks, addresses, camera facts and node states."""
