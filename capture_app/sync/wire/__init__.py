"""What nodes send each other and tell their cameras: messages, beacons, camera commands.

Imports `clock` only, whose time maps travel in messages.
"""
