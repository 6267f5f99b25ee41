"""The processes of a rig: a leader, a camera node and a relay, each a sync engine on a network and a disk."""
