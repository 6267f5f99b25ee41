"""Bytes on a disk that a pulled plug leaves whole: durable writes, locks, what a full disk says.

The ground of `session`: imports no other wing.
"""
