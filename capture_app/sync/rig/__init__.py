"""The leader and the client: who is in the rig, whose time it is, what is triggered, who takes over.

Puts all below it together into the two engines that nodes run.
"""
