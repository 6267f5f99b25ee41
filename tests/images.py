"""Image files that are whole by their header and end, for tests that look at no pixels."""

import struct


def small_jpeg(pixels: bytes = b"", width: int = 640, height: int = 480) -> bytes:
    """A JPEG with these bytes in place of compressed pixels."""
    frame = struct.pack(">BHHB", 8, height, width, 1) + b"\x01\x11\0"
    scan = b"\x01\x01\0\0\x3f\0"
    parts = ((b"\xff\xc0", frame), (b"\xff\xda", scan))
    header = b"".join(marker + struct.pack(">H", 2 + len(body)) + body for marker, body in parts)
    return b"\xff\xd8" + header + pixels + b"\xff\xd9"
