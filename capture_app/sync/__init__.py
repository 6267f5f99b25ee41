"""The sync engine, sans-IO: bytes, frame timestamps and `now_ns` in; bytes, camera commands and events out.

No socket, clock, thread or numpy anywhere in it, so that one engine runs over UDP, in virtual time and under
a property test, unchanged.
"""
