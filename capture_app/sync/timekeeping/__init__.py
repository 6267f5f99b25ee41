"""A node keeps its leader's time: when it asks, what it makes of the answers, and whether that will do.

Imports `clock`, `phase` (the leader's grid), `reference_broadcast` and `wire`; knows no members.
"""
