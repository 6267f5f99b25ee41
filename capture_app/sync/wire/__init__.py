"""What nodes say to each other and to their cameras: messages, beacons, camera commands.

Imports `clock` alone, whose time maps travel in messages; knows nothing of who sends them or why.
"""
