"""What a node and its leader say over streams, the status they publish, and the disk space that they tell.

Imports no other wing of `node`: both ends share it.
"""
