"""Injections, restarts and frame durations: how many, how long, beside the paper's way."""
