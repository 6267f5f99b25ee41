"""Nodes as processes: a leader, a camera, a relay, built of engine, network, driver and sessions.

From the ground up: `wire`, `burst`, `leader` and `camera`, `relay`.
"""
