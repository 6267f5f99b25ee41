"""Nodes that receive the same packet compare when they received it (reference broadcast, Elson 2002).

Imports `clock` and `wire`; an option of a rig, which works without.
"""
