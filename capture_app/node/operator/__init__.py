"""Who looks at a rig and gives it orders, over streams to its leader: the screen and the commands.

Imports `wire` only; a sibling of `leader`, which it only meets over the network.
"""
