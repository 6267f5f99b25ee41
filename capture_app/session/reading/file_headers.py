"""Image file headers, read without decoding pixels: the size, and a JPEG's EXIF (CIPA DC-008)."""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

JPEG_BEGIN = b"\xff\xd8"
_EXIF_IFD, _DATE, _PART, _FOCAL_35MM = 0x8769, 0x9003, 0x9291, 0xA405
_WIDTH, _HEIGHT, _ORIENTATION = 0x0100, 0x0101, 0x0112
MAX_ENTRIES = 4096
UPRIGHT = 1

MAX_BYTES = 1 << 28
"""Number of bytes read from a file; large because a TIFF may store its size at the end."""
MAX_HEADER_BYTES = 1 << 24
"""Limit on the profiles and thumbnails before a JPEG's first frame header, bytes."""


@dataclass(frozen=True)
class Exif:
    """EXIF fields of a JPEG; a field that the file lacks is empty or None."""

    date: str = ""
    """DateTimeOriginal; `part_of_second` is SubSecTimeOriginal."""
    part_of_second: str = ""
    focal_35mm: int | None = None
    """35 mm equivalent focal length, mm: same diagonal field of view."""
    orientation: int = UPRIGHT
    """EXIF orientation, 1 (already upright) to 8: the transform that shows the image upright."""


def read_exif(data: bytes) -> Exif:
    """Return the EXIF fields in a JPEG's bytes. Raises ValueError if the EXIF is malformed."""
    try:
        place = 2
        while data[place : place + 1] == b"\xff" and data[place + 1] != 0xDA:
            length = struct.unpack_from(">H", data, place + 2)[0]
            if data[place + 1] == 0xE1 and data[place + 4 : place + 10] == b"Exif\0\0":
                return _read_tiff(data[place + 10 : place + 2 + length])
            place += 2 + length
    except (struct.error, IndexError) as error:
        raise ValueError(str(error)) from error
    return Exif()


def _read_tiff(tiff: bytes) -> Exif:
    order = {b"II": "<", b"MM": ">"}.get(bytes(tiff[:2]))
    if order is None:
        raise ValueError("neither II nor MM")
    first = _entries(tiff, order, struct.unpack_from(f"{order}I", tiff, 4)[0])
    orientation = UPRIGHT
    if _ORIENTATION in first:
        orientation = struct.unpack_from(f"{order}H", first[_ORIENTATION][2])[0]
    if _EXIF_IFD not in first:
        return Exif(orientation=orientation)
    inner = _entries(tiff, order, struct.unpack(f"{order}I", first[_EXIF_IFD][2])[0])
    focal = struct.unpack_from(f"{order}H", inner[_FOCAL_35MM][2])[0] if _FOCAL_35MM in inner else 0
    date, part = (_text(tiff, order, inner.get(tag)) for tag in (_DATE, _PART))
    return Exif(date, part, focal or None, orientation)


def _entries(tiff: bytes, order: str, place: int, *, big: bool = False) -> dict[int, tuple[int, int, bytes]]:
    """Return a TIFF directory by tag: value type, value count, and the values' bytes or their offset."""
    number, entry = ("Q", struct.Struct(f"{order}HHQ8s")) if big else ("H", struct.Struct(f"{order}HHI4s"))
    begin = place + struct.calcsize(number)
    count = min(struct.unpack_from(f"{order}{number}", tiff, place)[0], MAX_ENTRIES)
    entries = (entry.unpack_from(tiff, begin + n * entry.size) for n in range(count))
    return {tag: (kind, length, value) for tag, kind, length, value in entries}


def _text(tiff: bytes, order: str, entry: tuple[int, int, bytes] | None) -> str:
    if entry is None:
        return ""
    _, count, value = entry
    start = struct.unpack(f"{order}I", value)[0]
    found = value[:count] if count <= 4 else tiff[start : start + count]
    return found.rstrip(b"\0 ").decode("ascii")


Size = tuple[int, int]
"""Width and height, px; for a JPEG, before its EXIF orientation is applied."""


def picture_size(path: Path) -> Size | None:
    """Return width and height of a JPEG, PNG, TIFF, BMP or WebP file; None for any other file.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        return size_of(file.read(MAX_BYTES))


def size_of(data: bytes) -> Size | None:
    """Return width and height from a file's bytes, as `picture_size` does."""
    start = bytes(data[:16])
    read = next((read for magic, read in _READERS if start.startswith(magic)), None)
    try:
        return read(data) if read is not None else None
    except (struct.error, ValueError, IndexError, OverflowError):
        return None


def _png(data: bytes) -> Size:
    width, height = struct.unpack_from(">II", data, 16)
    return width, height


def _jpeg(data: bytes) -> Size | None:
    at = 2
    while (at := data.find(b"\xff", at, MAX_HEADER_BYTES)) >= 0:
        while data[at] == 0xFF:
            at += 1
        marker, at = data[at], at + 1
        # Start of frame of any type; the three other markers in this range are tables.
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">3xHH", data, at)
            return width, height
        if not (0xD0 <= marker <= 0xD8 or marker in (0x00, 0x01)):
            at += max(struct.unpack_from(">H", data, at)[0], 2)
    return None


def _bmp(data: bytes) -> Size:
    width, height = struct.unpack_from("<ii", data, 18)
    return abs(width), abs(height)


def _tiff(data: bytes) -> Size | None:
    order = "<" if data[:2] == b"II" else ">"
    (version,) = struct.unpack_from(f"{order}H", data, 2)
    # BigTIFF (version 43) has 64-bit offsets and counts.
    place = {42: ("I", 4), 43: ("Q", 8)}.get(version)
    if place is None:
        return None
    (directory,) = struct.unpack_from(f"{order}{place[0]}", data, place[1])
    entries = _entries(data, order, directory, big=version == 43)
    if not {_WIDTH, _HEIGHT} <= set(entries):
        return None
    width, height = (
        struct.unpack_from(f"{order}{'H' if entries[tag][0] == 3 else 'I'}", entries[tag][2])[0]
        for tag in (_WIDTH, _HEIGHT)
    )
    return width, height


def _webp(data: bytes) -> Size | None:
    kind = data[12:16]
    if data[8:12] != b"WEBP" or len(data) < 30:
        return None
    if kind == b"VP8X":
        return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    if kind == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    width, height = struct.unpack_from("<HH", data, 26)
    return width & 0x3FFF, height & 0x3FFF


_READERS: tuple[tuple[bytes, Callable[[bytes], Size | None]], ...] = (
    (b"\x89PNG\r\n\x1a\n", _png),
    (JPEG_BEGIN, _jpeg),
    (b"BM", _bmp),
    (b"II", _tiff),
    (b"MM", _tiff),
    (b"RIFF", _webp),
)
