"""Nodes that hear the same packet agree on when they heard it (reference broadcast, Elson 2002).

Imports `clock` and `wire`; an option of a rig, which works without.
"""
