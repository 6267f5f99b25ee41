"""What a node and its leader say over streams, and the status they publish.

Imports no other wing of `node`: both ends share it.
"""
