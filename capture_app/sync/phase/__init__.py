"""One camera's frames brought into phase: shared goal, aligner, actuators.

Imports `clock`, `stamps` and `wire` (camera commands); knows one camera and no other node.
"""
