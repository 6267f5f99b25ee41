"""EXIF and size by a file's first bytes.

What a JPEG's EXIF says (CIPA DC-008): when it was taken, how it is held, and how wide its lens saw.

The size of a picture as its file's first bytes tell it, before a single pixel is decoded.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

_EXIF_IFD, _DATE, _PART, _FOCAL_35MM = 0x8769, 0x9003, 0x9291, 0xA405
_ORIENTATION = 0x0112
UPRIGHT = 1


@dataclass(frozen=True)
class Exif:
    """Empty or None where it does not say."""

    date: str = ""
    """DateTimeOriginal, and SubSecTimeOriginal."""
    part_of_second: str = ""
    focal_35mm: int | None = None
    """Focal length in mm of a lens that sees as wide a diagonal on 35 mm film."""
    orientation: int = UPRIGHT
    """How the picture is to be turned to be seen upright: 1 (not at all) to 8."""


def read_exif(data: bytes) -> Exif:
    """The EXIF in a JPEG's bytes. Raises ValueError where it is broken."""
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
        orientation = struct.unpack_from(f"{order}H", first[_ORIENTATION][1])[0]
    if _EXIF_IFD not in first:
        return Exif(orientation=orientation)
    inner = _entries(tiff, order, struct.unpack(f"{order}I", first[_EXIF_IFD][1])[0])
    focal = struct.unpack_from(f"{order}H", inner[_FOCAL_35MM][1])[0] if _FOCAL_35MM in inner else 0
    date, part = (_text(tiff, order, inner.get(tag)) for tag in (_DATE, _PART))
    return Exif(date, part, focal or None, orientation)


def _entries(tiff: bytes, order: str, place: int) -> dict[int, tuple[int, bytes]]:
    """By tag, the count of values and the four bytes that hold them or where they are."""
    count = struct.unpack_from(f"{order}H", tiff, place)[0]
    entries = (struct.unpack_from(f"{order}HHI4s", tiff, place + 2 + 12 * n) for n in range(count))
    return {tag: (number, value) for tag, _, number, value in entries}


def _text(tiff: bytes, order: str, entry: tuple[int, bytes] | None) -> str:
    if entry is None:
        return ""
    count, value = entry
    start = struct.unpack(f"{order}I", value)[0]
    found = value[:count] if count <= 4 else tiff[start : start + count]
    return found.rstrip(b"\0 ").decode("ascii")


Size = tuple[int, int]
"""Width and height, px; of a JPEG before its EXIF orientation is applied."""

MAX_HEADER_BYTES = 1 << 20
"""Of a JPEG's profiles and thumbnails before its first frame."""


def picture_size(path: Path) -> Size | None:
    """Width and height of a JPEG, PNG, TIFF, BMP or WebP file; None for anything else.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        return size_of(file)


def size_of(file: BinaryIO) -> Size | None:
    """The same of an open file. Raises OSError."""
    start = file.read(32)
    for magic, read in _READERS:
        if start.startswith(magic):
            file.seek(0)
            try:
                return read(file)
            except (struct.error, ValueError, OverflowError):
                return None
    return None


def _png(file: BinaryIO) -> Size:
    file.seek(16)
    return _numbers(">II", file)


def _jpeg(file: BinaryIO) -> Size | None:
    file.seek(2)
    while file.tell() < MAX_HEADER_BYTES:
        byte = file.read(1)
        if byte != b"\xff":
            if not byte:
                return None
            continue
        marker = file.read(1)
        while marker == b"\xff":
            marker = file.read(1)
        # A frame of any kind; the three others in this span are tables.
        if marker and 0xC0 <= marker[0] <= 0xCF and marker[0] not in (0xC4, 0xC8, 0xCC):
            height, width = _numbers(">3xHH", file)
            return width, height
        if marker and (0xD0 <= marker[0] <= 0xD8 or marker[0] in (0x00, 0x01)):
            continue
        (length,) = struct.unpack(">H", file.read(2))
        file.seek(max(length - 2, 0), 1)
    return None


def _bmp(file: BinaryIO) -> Size:
    file.seek(18)
    width, height = _numbers("<ii", file)
    return abs(width), abs(height)


def _tiff(file: BinaryIO) -> Size | None:
    order = "<" if file.read(2) == b"II" else ">"
    (version,) = struct.unpack(f"{order}H", file.read(2))
    if version not in (42, 43):
        return None
    # BigTIFF, version 43, has 64-bit offsets and counts.
    big = version == 43
    file.seek(8 if big else 4)
    directory = _number(file, order, "Q" if big else "I")
    file.seek(directory)
    found: dict[int, int] = {}
    for _ in range(min(_number(file, order, "Q" if big else "H"), 4096)):
        tag, kind = struct.unpack(f"{order}HH", file.read(4))
        file.read(8 if big else 4)
        field = file.read(8 if big else 4)
        if tag in (256, 257):
            form, size = ("H", 2) if kind == 3 else ("I", 4)
            (found[tag],) = struct.unpack(f"{order}{form}", field[:size])
    return (found[256], found[257]) if len(found) == 2 else None


def _number(file: BinaryIO, order: str, form: str) -> int:
    (number,) = struct.unpack(f"{order}{form}", file.read(struct.calcsize(f"{order}{form}")))
    return int(number)


def _webp(file: BinaryIO) -> Size | None:
    data = file.read(30)
    kind = data[12:16]
    if data[8:12] != b"WEBP" or len(data) < 30:
        return None
    if kind == b"VP8X":
        return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    if kind == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    width, height = struct.unpack("<HH", data[26:30])
    return width & 0x3FFF, height & 0x3FFF


def _numbers(form: str, file: BinaryIO) -> Size:
    first, second = struct.unpack(form, file.read(struct.calcsize(form)))
    return first, second


_READERS: tuple[tuple[bytes, Callable[[BinaryIO], Size | None]], ...] = (
    (b"\x89PNG\r\n\x1a\n", _png),
    (b"\xff\xd8", _jpeg),
    (b"BM", _bmp),
    (b"II", _tiff),
    (b"MM", _tiff),
    (b"RIFF", _webp),
)
