"""Pictures of machine-vision cameras: every usable format becomes a JPEG and a preview in its colours."""

import cv2
import numpy as np
import pytest

from capture_app.cameras.frames import PixelPicture
from capture_app.plugins.cameras.aravis.aravis_device import USABLE_FORMATS, machine_picture, split_format

WIDTH, HEIGHT = 64, 48
BGR = (40, 120, 220)


def picture_of(pixel_format: str) -> PixelPicture:
    """A plain picture of one colour, as a camera of that format would send it."""
    layout, bits = split_format(pixel_format)
    by_letter = dict(zip("BGR", BGR, strict=True))
    if layout.startswith("Bayer"):
        cells = {"RG": "RGGB", "GR": "GRBG", "GB": "GBRG", "BG": "BGGR"}[layout[-2:]]
        cell = np.array([by_letter[letter] for letter in cells]).reshape(2, 2)
        pixels = np.tile(cell, (HEIGHT // 2, WIDTH // 2))
    elif layout == "Mono":
        pixels = np.full((HEIGHT, WIDTH), BGR[1])
    else:
        pixels = np.full((HEIGHT, WIDTH, 3), [by_letter[letter] for letter in layout])
    data = pixels.astype(np.uint8) if bits == 8 else (pixels << (bits - 8)).astype("<u2")
    return machine_picture(data.tobytes(), (WIDTH, HEIGHT), pixel_format)


@pytest.mark.parametrize("pixel_format", USABLE_FORMATS)
def test_every_usable_format_has_its_colours(pixel_format: str) -> None:
    picture = picture_of(pixel_format)
    decoded = cv2.imdecode(np.frombuffer(picture.encode(), np.uint8), cv2.IMREAD_COLOR)
    assert decoded.shape == (HEIGHT, WIDTH, 3)
    expected = (BGR[1],) * 3 if pixel_format.startswith("Mono") else BGR
    for seen in (decoded, picture.reduced(32)):
        assert np.abs(seen[8:-8, 8:-8].mean((0, 1)) - expected).max() < 4
    assert picture.reduced(32).shape == (HEIGHT // 2, WIDTH // 2, 3)
    channels, bits = (3 if pixel_format[:3] in ("RGB", "BGR") else 1), split_format(pixel_format)[1]
    assert picture.held_bytes == WIDTH * HEIGHT * channels * (1 if bits == 8 else 2)
