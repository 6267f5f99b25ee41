"""Damage of an image file, found by its header and its end."""

import cv2
import numpy as np
import pytest

from capture_app.session.reading.decoding import MAX_ENTRIES, damage, is_whole_jpeg

SIZE = (64, 48)


def encoded(suffix: str, width: int = 64, height: int = 48, *options: int) -> bytes:
    noise = np.random.default_rng(1).integers(0, 255, (height, width, 3), np.uint8)
    return bytes(cv2.imencode(suffix, noise, [*options])[1])


JPEG = encoded(".jpg")
THUMBNAIL = b"\xff\xe1" + (2 + len(JPEG)).to_bytes(2, "big") + JPEG


@pytest.mark.parametrize(
    "data",
    [
        JPEG,
        JPEG + bytes(5000),
        encoded(".jpg", 64, 48, cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
        encoded(".jpg", 64, 48, cv2.IMWRITE_JPEG_RST_INTERVAL, 1),
        JPEG[:2] + THUMBNAIL + JPEG[2:],
        encoded(".png"),
        encoded(".tiff"),
    ],
    ids=["jpeg", "filled up", "progressive", "restart markers", "thumbnail", "png", "tiff"],
)
def test_a_whole_image_has_none(data: bytes) -> None:
    assert damage(data, SIZE) == ""


@pytest.mark.parametrize(
    ("data", "wrong"),
    [
        (b"12345", "not an image"),
        (b"", "not an image"),
        (JPEG[:30], "not an image"),
        (JPEG[: len(JPEG) // 2], "cut off"),
        (JPEG[:-2], "cut off"),
        (JPEG[:2] + THUMBNAIL + JPEG[2:-2], "cut off"),
        (encoded(".jpg", 640, 480), "640x480 pixels, not 64x48"),
        (encoded(".png", 48, 64), "48x64 pixels, not 64x48"),
    ],
    ids=["5 bytes", "nothing", "header", "half", "no end", "thumbnail", "larger", "turned"],
)
def test_a_damaged_image_is_told(data: bytes, wrong: str) -> None:
    assert damage(data, SIZE) == wrong


def test_a_header_of_many_parts_is_not_read_to_its_end() -> None:
    part = b"\xff\xe0\0\x02"
    assert is_whole_jpeg(JPEG[:2] + part * 100 + JPEG[2:])
    assert damage(JPEG[:2] + part * MAX_ENTRIES + JPEG[2:], SIZE) == "not an image"
