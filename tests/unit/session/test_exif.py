"""What an image's EXIF says of it: its date, its zone, and how it is to be turned."""

import struct

import cv2
import numpy as np
import pytest

from capture_app.session.reading.decoding import Exif, decode_turned, read_exif

from .conftest import jpeg

DATE, PART, OFFSET, ORIENTATION, INNER = 0x9003, 0x9291, 0x9011, 0x0112, 0x8769


def tiff(order: str, orientation: int, texts: dict[int, bytes]) -> bytes:
    """A TIFF with an orientation, and texts in its inner directory: up to four bytes lie in the entry."""
    begin = {"<": b"II", ">": b"MM"}[order] + struct.pack(f"{order}HI", 42, 8)
    inner_at = 8 + 2 + 2 * 12
    outer = struct.pack(f"{order}HHHIHxxHHII", 2, ORIENTATION, 3, 1, orientation, INNER, 4, 1, inner_at)
    place, entries, behind = inner_at + 2 + 12 * len(texts), b"", b""
    for tag, text in texts.items():
        is_short = len(text) <= 4
        value = text.ljust(4, b"\0") if is_short else struct.pack(f"{order}I", place + len(behind))
        entries += struct.pack(f"{order}HHI", tag, 2, len(text)) + value
        behind += b"" if is_short else text
    return begin + outer + struct.pack(f"{order}H", len(texts)) + entries + behind


def with_exif(data: bytes, exif: bytes) -> bytes:
    """A JPEG with an application's segment, and then one with this EXIF."""
    body = b"Exif\0\0" + exif
    other = b"\xff\xe1" + struct.pack(">H", 10) + b"http:\0\0\0"
    return data[:2] + other + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + data[2:]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("part", [b"12\0", b"123\0", b"123456\0"])
def test_the_date_of_a_photograph_is_read_with_its_zone_and_part_of_a_second(order: str, part: bytes) -> None:
    texts = {DATE: b"2026:01:02 03:04:05\0", PART: part, OFFSET: b"+02:00\0"}
    exif = Exif("2026:01:02 03:04:05", part[:-1].decode(), None, 6, "+02:00")
    assert read_exif(with_exif(jpeg(1), tiff(order, 6, texts))) == exif
    assert read_exif(tiff(order, 6, texts)) == exif
    assert read_exif(with_exif(jpeg(1), tiff(order, 1, {}))) == Exif()
    assert read_exif(jpeg(1)) == Exif()


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_photograph_is_turned_as_other_programs_turn_it(orientation: int) -> None:
    data = with_exif(jpeg(1), tiff("<", orientation, {}))
    turned, shown = decode_turned(data), cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if orientation == 1:
        assert turned is None, "it is copied as it is"
    else:
        assert turned is not None
        np.testing.assert_array_equal(turned, shown)
