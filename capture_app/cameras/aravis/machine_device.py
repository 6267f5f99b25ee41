"""Frames as a machine-vision camera sends them: grey, Bayer or colour."""

from dataclasses import dataclass
from functools import partial
from math import prod
from typing import TYPE_CHECKING

from capture_app.cameras.frames import PixelPicture, step_to

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_CONVERSIONS = {
    "BayerRG": "COLOR_BayerRGGB2BGR",
    "BayerGR": "COLOR_BayerGRBG2BGR",
    "BayerGB": "COLOR_BayerGBRG2BGR",
    "BayerBG": "COLOR_BayerBGGR2BGR",
}
"""OpenCV's conversions by GenICam's Bayer patterns, which name the first two pixels of the first row."""
USABLE_FORMATS = (
    *(f"{layout}8" for layout in (*_CONVERSIONS, "RGB", "BGR", "Mono")),
    *(f"{layout}{bits}" for layout in (*_CONVERSIONS, "Mono") for bits in (16, 12, 10)),
)
"""Pixel formats that can be saved, best first; values of more than 8 bits take 16 bits each."""


@dataclass(frozen=True, slots=True)
class DeviceFrame:
    """One frame as the library delivered it."""

    number: int
    """Frame number of the transport: 16 bits without 0, or wider."""
    counter_ns: int
    """Timestamp by the camera's own counter."""
    arrival_ns: int
    """Arrival of its first packet, in the host's monotonic clock."""
    data: bytes | None
    """None if packets are missing."""


def machine_picture(data: bytes, size: tuple[int, int], pixel_format: str) -> PixelPicture:
    """Return an image as the camera sent it; `size` is (width, height), `pixel_format` GenICam's name."""
    return PixelPicture(len(data), partial(_pixels, data, size, pixel_format))


def _pixels(
    data: bytes, size: tuple[int, int], pixel_format: str, min_width: int | None
) -> "NDArray[np.uint8]":
    """Return 8-bit pixels as in `PixelPicture.pixels`."""
    import cv2
    import numpy as np

    (width, height), (layout, bits) = size, split_format(pixel_format)
    shape = (height, width, 3) if layout in ("RGB", "BGR") else (height, width)
    kind = np.dtype("u1" if bits == 8 else "<u2")
    pixels = np.frombuffer(data, kind, prod(shape)).reshape(shape)
    picture = pixels if bits == 8 else (pixels >> (bits - 8)).astype(np.uint8)
    if layout == "RGB":
        picture = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
    elif layout in _CONVERSIONS:
        picture = cv2.cvtColor(picture, getattr(cv2, _CONVERSIONS[layout]))
    step = step_to(width, min_width)
    return np.asarray(picture, np.uint8)[::step, ::step]


def split_format(pixel_format: str) -> tuple[str, int]:
    """Split a usable format's name into layout and bits, such as BayerRG and 12."""
    layout = pixel_format.rstrip("0123456789")
    return layout, int(pixel_format[len(layout) :])
