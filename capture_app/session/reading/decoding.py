"""Image files: size and EXIF (CIPA DC-008) from their headers, decoding, encoding."""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from capture_app.common.errors import BadInputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

JPEG_BEGIN, JPEG_END = b"\xff\xd8", b"\xff\xd9"
PNG_BEGIN = b"\x89PNG\r\n\x1a\n"
_EXIF_SEGMENT = 0xE1, b"Exif\0\0"
_TIFF_BEGINS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
MAX_PADDING = 1 << 20
"""Limit on the bytes that a camera adds to a JPEG after its end."""
_EXIF_IFD, _DATE, _OFFSET, _PART, _FOCAL_35MM = 0x8769, 0x9003, 0x9011, 0x9291, 0xA405
_PIXELS = 0xDA
"""Marker of a JPEG's first scan, which its compressed pixels follow."""
_WIDTH, _HEIGHT, _ORIENTATION = 0x0100, 0x0101, 0x0112
MAX_ENTRIES = 4096
UPRIGHT = 1
Entry = tuple[int, int, bytes]
"""Entry of a TIFF directory: value type, value count, and the values' bytes or their offset."""

MAX_BYTES = 1 << 28
"""Number of bytes read from a file; large because a TIFF may store its size at the end."""
MAX_HEADER_BYTES = 1 << 24
"""Limit on the profiles and thumbnails before a JPEG's first frame header, bytes."""
MAX_PIXELS = 1 << 28
"""Largest stored image that is decoded, px; no camera takes a larger one."""
MAX_BLANK_PIXELS, MAX_PIXELS_A_BYTE = 1 << 25, 64
"""Largest image of any file size that is decoded, px, and the maximum pixels a byte of a larger one.

A black PNG of MAX_PIXELS has 800 kB, and would take 1.5 GB. A photograph has up to ten pixels a byte.
"""
MAX_SENT_PIXELS = 1 << 24
"""Largest preview that is decoded, px: eight times the largest one asked for; it takes up to 150 MB."""
JPEG_QUALITY = 95


@dataclass(frozen=True)
class Exif:
    """EXIF fields of an image file; a field that the file lacks is empty or None."""

    date: str = ""
    """DateTimeOriginal; `part_of_second` is SubSecTimeOriginal."""
    part_of_second: str = ""
    focal_35mm: int | None = None
    """35 mm equivalent focal length, mm: same diagonal field of view."""
    orientation: int = UPRIGHT
    """EXIF orientation, 1 (already upright) to 8: the transform that shows the image upright."""
    offset: str = ""
    """OffsetTimeOriginal, such as +02:00: the zone of the date."""


def read_exif(data: bytes) -> Exif:
    """Return the EXIF fields in the bytes of an image file. Raises ValueError if the EXIF is malformed."""
    try:
        tiff = _exif_bytes(bytes(data))
        return _exif_of_tiff(tiff) if tiff else Exif()
    except (struct.error, IndexError, OverflowError) as error:
        raise ValueError(str(error)) from error


def _exif_bytes(data: bytes) -> bytes:
    """Return the TIFF with the EXIF of a JPEG, PNG or TIFF file; empty if it has none."""
    if data.startswith(JPEG_BEGIN):
        exif = (at for marker, at in _segments(data) if (marker, data[at + 2 : at + 8]) == _EXIF_SEGMENT)
        return next((data[at + 8 : at + struct.unpack_from(">H", data, at)[0]] for at in exif), b"")
    if data.startswith(PNG_BEGIN):
        return next((data[at : at + length] for name, at, length in _chunks(data) if name == b"eXIf"), b"")
    return data if data[:4] in _TIFF_BEGINS else b""


def _chunks(png: bytes) -> Iterator[tuple[bytes, int, int]]:
    """Yield name, place and length of a PNG's chunks; the last one may reach beyond the file's end."""
    at = len(PNG_BEGIN)
    while at + 8 <= len(png):
        length, name = struct.unpack_from(">I4s", png, at)
        yield name, at + 8, length
        at += 12 + length


def _segments(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield marker and place of a JPEG's segments up to its pixels; at the place is the segment's length."""
    at, marker = 2, 0
    while marker != _PIXELS and (at := data.find(b"\xff", at, MAX_HEADER_BYTES)) >= 0:
        while data[at] == 0xFF:
            at += 1
        marker, at = data[at], at + 1
        if not (0xD0 <= marker <= 0xD8 or marker in (0x00, 0x01)):
            yield marker, at
            at += max(struct.unpack_from(">H", data, at)[0], 2)


def _exif_of_tiff(tiff: bytes) -> Exif:
    order, first = _directory(tiff)
    inner = _entries(tiff, order, _number(order, first[_EXIF_IFD])) if _EXIF_IFD in first else {}
    orientation, focal = (
        _number(order, directory[tag]) if tag in directory else 0
        for directory, tag in ((first, _ORIENTATION), (inner, _FOCAL_35MM))
    )
    date, part, offset = (_text(tiff, order, inner.get(tag)) for tag in (_DATE, _PART, _OFFSET))
    return Exif(date, part, focal or None, orientation or UPRIGHT, offset)


def _directory(tiff: bytes) -> tuple[str, dict[int, Entry]]:
    """Return a TIFF's byte order as in `struct`, and its first directory. Raises ValueError, struct.error."""
    order = {b"II": "<", b"MM": ">"}.get(bytes(tiff[:2]))
    if order is None:
        raise ValueError("neither II nor MM")
    # BigTIFF (version 43) has 64-bit offsets and counts.
    big = struct.unpack_from(f"{order}H", tiff, 2)[0] == 43
    (place,) = struct.unpack_from(f"{order}Q", tiff, 8) if big else struct.unpack_from(f"{order}I", tiff, 4)
    return order, _entries(tiff, order, place, big=big)


def _entries(tiff: bytes, order: str, place: int, *, big: bool = False) -> dict[int, Entry]:
    """Return the directory of a TIFF at an offset, by tag."""
    number, entry = ("Q", struct.Struct(f"{order}HHQ8s")) if big else ("H", struct.Struct(f"{order}HHI4s"))
    begin = place + struct.calcsize(number)
    count = min(struct.unpack_from(f"{order}{number}", tiff, place)[0], MAX_ENTRIES)
    entries = (entry.unpack_from(tiff, begin + n * entry.size) for n in range(count))
    return {tag: (kind, length, value) for tag, kind, length, value in entries}


def _number(order: str, entry: Entry) -> int:
    return int(struct.unpack_from(order + {3: "H", 16: "Q"}.get(entry[0], "I"), entry[2])[0])


def _text(tiff: bytes, order: str, entry: Entry | None) -> str:
    _, count, value = entry or (0, 0, bytes(4))
    start = struct.unpack(f"{order}I", value)[0]
    return (value[:count] if count <= 4 else tiff[start : start + count]).rstrip(b"\0 ").decode("ascii")


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
    read = next((read for magic, read in _READERS if bytes(data[:16]).startswith(magic)), None)
    try:
        return read(data) if read is not None else None
    except (struct.error, ValueError, LookupError, OverflowError):
        return None


def _jpeg(data: bytes) -> Size:
    # Start of frame of any type; the three other markers in this range are tables.
    frames = (
        at
        for marker, at in islice(_segments(data), MAX_ENTRIES)
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC)
    )
    height, width = struct.unpack_from(">3xHH", data, next(frames, len(data)))
    return width, height


def is_whole_jpeg(data: bytes) -> bool:
    """Return whether the end of a JPEG's pixels is there; bytes that a camera adds after it do not matter."""
    try:
        pixels = next(at for marker, at in islice(_segments(data), MAX_ENTRIES) if marker == _PIXELS)
    except (StopIteration, struct.error, IndexError):
        return False
    return data.rfind(JPEG_END, max(pixels, len(data) - MAX_PADDING)) >= 0


def damage(data: bytes, size: Size) -> str:
    """Return what is wrong with an image file of a camera of that size, by its header and end; else empty."""
    own = size_of(data)
    if own == size:
        return "cut off" if data.startswith(JPEG_BEGIN) and not is_whole_jpeg(data) else ""
    return "not an image" if own is None else f"{own[0]}x{own[1]} pixels, not {size[0]}x{size[1]}"


def _png(data: bytes) -> Size:
    width, height = struct.unpack_from(">II", data, 16)
    # OpenCV takes the memory that a chunk claims: eight bytes a pixel at most, or a profile's.
    if any(length > MAX_HEADER_BYTES + 8 * width * height for _, _, length in _chunks(data)):
        raise ValueError("a chunk is longer than the image")
    return width, height


def _bmp(data: bytes) -> Size:
    width, height = struct.unpack_from("<ii", data, 18)
    return abs(width), abs(height)


def _tiff(data: bytes) -> Size:
    order, entries = _directory(data)
    return _number(order, entries[_WIDTH]), _number(order, entries[_HEIGHT])


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
    (PNG_BEGIN, _png),
    (JPEG_BEGIN, _jpeg),
    (b"BM", _bmp),
    *((begin, _tiff) for begin in _TIFF_BEGINS),
    (b"RIFF", _webp),
)


def decode_image(
    data: bytes,
    *,
    colour: bool = False,
    min_width: int = 0,
    max_pixels: int = MAX_PIXELS,
) -> "NDArray[np.uint8] | None":
    """Decode an image file's bytes; return None if they are not an image or if it exceeds `max_pixels`.

    A small file can claim a huge size, or have one and be blank: neither is decoded, and no file whose header
    gives no size. `colour`: return
    height x width x BGR of 8 bits, whatever the file contains; with `min_width`, decode at a half, a quarter
    or an eighth of the size as long as the width stays at least that, which is faster. The EXIF orientation
    is ignored: imported images are upright.
    """
    limit = min(max_pixels, max(MAX_BLANK_PIXELS, MAX_PIXELS_A_BYTE * len(data)))
    if (size := size_of(data)) is None or not 0 < size[0] * size[1] <= limit:
        return None
    import cv2  # heavy: imported only when an image is decoded
    import numpy as np

    flags = cv2.IMREAD_UNCHANGED
    if colour:
        sizes = (
            (8, cv2.IMREAD_REDUCED_COLOR_8),
            (4, cv2.IMREAD_REDUCED_COLOR_4),
            (2, cv2.IMREAD_REDUCED_COLOR_2),
        )
        fitting = (flag for by, flag in sizes if min_width and size[0] >= by * min_width)
        flags = next(fitting, cv2.IMREAD_COLOR) | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        return None


def decode_turned(data: bytes) -> "NDArray[np.uint8] | None":
    """Decode an image file that its EXIF has to be turned, and turn it; None for any other file."""
    try:
        orientation = read_exif(data).orientation
    except ValueError:
        return None
    image = decode_image(data) if orientation in range(2, 9) else None
    # OpenCV turns a TIFF whatever it is asked for.
    return image if image is None or data[:4] in _TIFF_BEGINS else rotate_upright(image, orientation)


def rotate_upright(image: "NDArray[np.uint8]", orientation: int) -> "NDArray[np.uint8]":
    """Return an image transformed by an EXIF orientation, 1 to 8."""
    import numpy as np

    turned = np.swapaxes(image, 0, 1) if orientation > 4 else image
    rows, columns = (-1 if orientation in flipped else 1 for flipped in ((3, 4, 7, 8), (2, 3, 6, 7)))
    return np.ascontiguousarray(turned[::rows, ::columns])


def decode_preview(data: bytes) -> "NDArray[np.uint8] | None":
    """Decode a preview or a phone's picture as BGR, as `decode_image` does up to MAX_SENT_PIXELS."""
    return decode_image(data, colour=True, max_pixels=MAX_SENT_PIXELS)


def image_size(data: bytes) -> tuple[int, int] | None:
    """Decode an image file's bytes and return width and height in px; None if they are not an image.

    An eighth of a JPEG's size reads all of its data, and fails where the whole size does.
    """
    if data.startswith(JPEG_BEGIN):
        return None if decode_image(data, colour=True, min_width=1) is None else size_of(data)
    image = decode_image(data)
    return None if image is None else (image.shape[1], image.shape[0])


def encode_image(image: "NDArray[np.uint8]", suffix: str = ".jpg", quality: int = JPEG_QUALITY) -> bytes:
    """Encode an image in the format of `suffix`; `quality` applies to JPEG. Raises BadInputError."""
    import cv2

    options = [cv2.IMWRITE_JPEG_QUALITY, quality] if suffix == ".jpg" else []
    made, data = cv2.imencode(suffix, image, options)
    if not made:
        raise BadInputError(
            f"the picture cannot be written as {suffix[1:].upper()}", hint="write a .jpg or .png"
        )
    return bytes(data.tobytes())
