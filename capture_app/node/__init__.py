"""Processes of a rig: a leader, a camera node and a relay, each a sync engine with a network and a disk."""
