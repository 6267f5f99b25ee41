"""One camera's frames brought into phase: shared grid, aligner, actuators.

Imports `clock`, `stamps` and `wire` (camera commands); knows one camera and no other node.
"""
