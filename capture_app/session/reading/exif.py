"""What a JPEG's EXIF says (CIPA DC-008): when it was taken, how it is held, and how wide its lens saw."""

import struct
from dataclasses import dataclass

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
