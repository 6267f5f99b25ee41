"""Protocols of other programs that follow our time as they are: libsoftwaresync, RecSync, rpicam-apps.

They have no seals and no pairing. Imports the time's arithmetic and poll schedules, no rig.
"""
