"""Sensors, links, scenes and whole rigs that behave as real ones do, in virtual time.

`devices` and `network`, of which `rig` is made; `scenes`, which `rendering` films.
"""
