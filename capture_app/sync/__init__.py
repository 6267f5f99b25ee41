"""The sync engine, sans-IO: bytes, timestamps and `now_ns` in; bytes, commands and events out."""
