"""Links, radio cells and wandering clocks in virtual time.

Imports no other wing of `simulation`.
"""
