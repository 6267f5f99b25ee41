"""Frames as cameras give them, with pictures copied out of the driver's buffers: JPEG or pixels."""

import os
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Protocol

from capture_app.session.reading.decoding import decode_image, encode_image

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_JPEG_START = b"\xff\xd8"
LOW_PRIORITY = 10
"""Niceness of threads that encode pictures: the clock exchange comes first."""


class FramePicture(Protocol):
    """A frame's picture, encoded only when it is saved."""

    @property
    def held_bytes(self) -> int:
        """How much memory it takes."""

    def encode(self) -> bytes:
        """Return the image file's bytes (JPEG). May take a second: call it off the event loop."""

    def reduced(self, width: int) -> "NDArray[np.uint8]":
        """Return the picture, BGR uint8 (H, W, 3), about `width` pixels wide or wider, as is cheap.

        Raises ValueError for a picture that cannot be decoded. Call it off the event loop.
        """


@dataclass(frozen=True, slots=True)
class GroundTruth:
    """What the simulator knows of a frame."""

    true_ns: int
    """True start of the first row's exposure, in the host's monotonic clock."""
    encode: Callable[[], bytes]
    """Renders the bytes of an .npz with `depth_m` (float32 HxW), `objects` (uint8), `movers` (bool)."""


@dataclass(frozen=True, slots=True)
class CapturedFrame:
    """One frame as the driver delivered it; times in ns of the node's own clock."""

    sequence: int
    """The driver's frame number since the stream started; a gap is a dropped frame."""
    stream: int
    """Counts the stream's starts: sequence numbers compare only within one stream."""
    timestamp_ns: int
    picture: FramePicture
    exposure_ns: int | None = None
    gain: float | None = None
    white_balance: tuple[float, float] | None = None
    """Red and blue gains over green."""
    truth: GroundTruth | None = None
    clock_uncertainty_ns: int = 0
    """95 % error of the timestamp's way into the node's clock, where the device stamps by one of its own."""


@dataclass(frozen=True, slots=True)
class JpegPicture:
    """A JPEG as the camera made it."""

    data: bytes

    @property
    def held_bytes(self) -> int:
        """How much memory it takes."""
        return len(self.data)

    def encode(self) -> bytes:
        """Return the camera's own bytes."""
        return self.data

    def reduced(self, width: int) -> "NDArray[np.uint8]":
        """Return the picture, BGR uint8 (H, W, 3), decoded at a half, a quarter or an eighth where that does.

        Raises ValueError for bytes that are no picture.
        """
        picture = decode_image(self.data, colour=True, at_least=width)
        if picture is None:
            raise ValueError("the camera's JPEG cannot be decoded")
        return picture


@dataclass(frozen=True, slots=True)
class PixelPicture:
    """A picture that is no JPEG yet."""

    held_bytes: int
    """How much memory it takes."""
    pixels: "Callable[[int | None], NDArray[np.uint8]]"
    """Makes it, BGR (H, W, 3) or grey (H, W): whole for None, or of every so-manieth, about that wide."""

    def encode(self) -> bytes:
        """Return a JPEG of quality 95."""
        return encode_image(self.pixels(None))

    def reduced(self, width: int) -> "NDArray[np.uint8]":
        """Return the picture, BGR uint8 (H, W, 3), of every so-manieth pixel."""
        import cv2
        import numpy as np

        picture = self.pixels(width)
        if picture.ndim == 2:
            return np.asarray(cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_GRAY2BGR), np.uint8)
        return picture


def step_to(full: int, width: int | None) -> int:
    """Of every how many pixels a picture `full` wide is to be, to be at least `width` wide; None: of all."""
    return 1 if width is None else max(1, full // max(width, 1))


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """The picture as it lies in memory; sizes in pixels and bytes."""

    fourcc: str
    width: int
    height: int
    bytes_per_line: int
    buffer_bytes: int = 0
    """Memory that one frame takes at most."""


def raw_picture(data: bytes, layout: PixelFormat) -> PixelPicture:
    """An uncompressed picture as it lay in the driver's buffer."""
    return PixelPicture(len(data), partial(_raw_pixels, data, layout))


def _raw_pixels(data: bytes, layout: PixelFormat, wanted: int | None) -> "NDArray[np.uint8]":
    import cv2
    import numpy as np

    step = step_to(layout.width, wanted)
    width, height, stride, rows = layout.width, layout.height, layout.bytes_per_line, _rows(layout)
    plane = np.frombuffer(data, np.uint8, rows * stride).reshape(rows, stride)
    if layout.fourcc == "YUYV":
        # Two pixels share their colour: pairs are kept or left out together.
        pairs = plane[:, : 2 * width].reshape(height, width // 2, 4)[::step, ::step]
        packed = np.ascontiguousarray(pairs).reshape(pairs.shape[0], pairs.shape[1] * 2, 2)
        return np.asarray(cv2.cvtColor(packed, cv2.COLOR_YUV2BGR_YUYV), np.uint8)
    if layout.fourcc == "NV12":
        picture = cv2.cvtColor(np.ascontiguousarray(plane[:, :width]), cv2.COLOR_YUV2BGR_NV12)
        return np.asarray(picture[::step, ::step], np.uint8)
    return plane[::step, :width:step]


def picture_from_buffer(data: bytes, layout: PixelFormat) -> JpegPicture | PixelPicture | None:
    """The picture of a buffer's bytes; None where they cannot be a picture of that format."""
    if layout.fourcc in ("MJPG", "JPEG"):
        return JpegPicture(data) if data.startswith(_JPEG_START) else None
    return raw_picture(data, layout) if len(data) >= layout.bytes_per_line * _rows(layout) else None


def _rows(layout: PixelFormat) -> int:
    return layout.height * 3 // 2 if layout.fourcc == "NV12" else layout.height


def lower_priority() -> None:
    """Let all other threads of this process go before the present one."""
    # Linux knows a niceness for each thread; where there is none, all threads stay equal.
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), LOW_PRIORITY)
