"""One camera's frames brought into phase: estimator, shared goal, aligner, actuators.

Imports `clock` and `wire` (camera commands); knows one camera and no other node.
"""
