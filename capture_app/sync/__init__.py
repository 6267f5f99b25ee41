"""The sync engine, sans-IO: bytes, frame timestamps and `now_ns` in; bytes, camera commands and events out."""
