"""The sync engine, sans-IO: bytes, frame stamps, `now_ns` in; bytes, camera commands, events out.

From the ground up: `clock`, `stamps` and `wire`, `phase` and `reference_broadcast`, `timekeeping`, `rig`,
`tree`. No socket, clock, thread or numpy anywhere in it, so that one engine runs over UDP, in virtual time
and under a property test, unchanged.
"""
