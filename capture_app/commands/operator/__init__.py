"""The commands that look at a running rig or give it orders: clients of its leader, as the screen is.

Imports `options` of the commands, and none of the commands beside it.
"""
