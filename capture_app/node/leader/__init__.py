"""The process that nodes join: engine, network, sessions folder, and what its screen and commands ask.

Imports `burst` and `wire`.
"""
