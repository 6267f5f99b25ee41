"""Frames as a machine-vision camera sends them, grey, Bayer or colour."""

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
"""OpenCV's names of the patterns as GenICam's have them: by the first two pixels of the first row."""
USABLE_FORMATS = (
    *(f"{layout}8" for layout in (*_CONVERSIONS, "RGB", "BGR", "Mono")),
    *(f"{layout}{bits}" for layout in (*_CONVERSIONS, "Mono") for bits in (16, 12, 10)),
)
"""The pixel formats that can be saved, the best first; more than 8 bits lie in 16 each."""


@dataclass(frozen=True, slots=True)
class DeviceFrame:
    """One frame as the library delivered it."""

    number: int
    """The transport's number: 16 bits without 0, or more."""
    counter_ns: int
    """The camera's stamp, by its own counter."""
    arrival_ns: int
    """When its first packet came, by the host's monotonic clock."""
    data: bytes | None
    """None where packets of it are missing."""


def machine_picture(data: bytes, size: tuple[int, int], pixel_format: str) -> PixelPicture:
    """A picture as the camera sent it; `size` is its width and height, `pixel_format` GenICam's name."""
    return PixelPicture(len(data), partial(_pixels, data, size, pixel_format))


def _pixels(data: bytes, size: tuple[int, int], pixel_format: str, wanted: int | None) -> "NDArray[np.uint8]":
    """See `PixelPicture.pixels`; of 8 bits."""
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
    step = step_to(width, wanted)
    return np.asarray(picture, np.uint8)[::step, ::step]


def split_format(pixel_format: str) -> tuple[str, int]:
    """The layout and the bits of a usable format's name, such as BayerRG and 12."""
    layout = pixel_format.rstrip("0123456789")
    return layout, int(pixel_format[len(layout) :])
