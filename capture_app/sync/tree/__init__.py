"""Rigs beyond one leader's reach: relays, and members that only keep the time.

Built of `rig`'s engines; nothing in `rig` knows that a leader may be a relay.
"""
