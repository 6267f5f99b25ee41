"""Files that survive a power cut: durable writes, locks, output folders, full disks.

The ground of `session`: imports no other wing.
"""
