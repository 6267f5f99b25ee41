"""The driver of simulated cameras: virtual sensors in real time, opened as real cameras are.

Imports `devices` and `rendering`.
"""
