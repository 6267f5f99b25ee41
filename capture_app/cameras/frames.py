"""Frames as cameras deliver them, with images copied out of the driver's buffers: JPEG or pixels."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Protocol

from capture_app.session.reading.decoding import JPEG_BEGIN, decode_image, encode_image, is_whole_jpeg

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class FramePicture(Protocol):
    """A frame's image, encoded only when it is saved."""

    @property
    def held_bytes(self) -> int:
        """Memory that the image takes, in bytes."""

    def encode(self) -> bytes:
        """Return the image file's bytes (JPEG). May take a second: call it off the event loop."""

    def reduced(self, width: int) -> "NDArray[np.uint8]":
        """Return the image, BGR uint8 (H, W, 3), in the cheapest size that is at least about `width` px wide.

        Raises ValueError for an image that cannot be decoded. Call it off the event loop.
        """


@dataclass(frozen=True, slots=True)
class CapturedFrame:
    """One frame as the driver delivered it; times in ns of the node's own clock."""

    sequence: int
    """The driver's frame number since the stream started; a gap is a dropped frame."""
    stream: int
    """Number of the stream's start; sequence numbers compare only within one stream."""
    timestamp_ns: int
    picture: FramePicture
    exposure_ns: int | None = None
    gain: float | None = None
    white_balance: tuple[float, float] | None = None
    """Red and blue gains over green."""
    true_ns: int | None = None
    """True start of a simulated frame's first row, in the host's monotonic clock."""
    encode_truth: Callable[[], bytes] | None = None
    """Renders a simulated frame's .npz of `depth_m` (float32 HxW), `objects` (uint8), `movers` (bool)."""
    clock_uncertainty_ns: int = 0
    """95 % error of the conversion from the device's own clock to the node's; 0 without such a clock."""


@dataclass(frozen=True, slots=True)
class JpegPicture:
    """A JPEG as the camera encoded it."""

    data: bytes

    @property
    def held_bytes(self) -> int:
        """Memory that the image takes, in bytes."""
        return len(self.data)

    def encode(self) -> bytes:
        """Return the JPEG's bytes as the camera sent them."""
        return self.data

    def reduced(self, width: int) -> "NDArray[np.uint8]":
        """Return the image, BGR uint8 (H, W, 3), decoded at 1/2, 1/4 or 1/8 scale where `width` allows it.

        Raises ValueError for bytes that cannot be decoded.
        """
        picture = decode_image(self.data, colour=True, min_width=width)
        if picture is None:
            raise ValueError("the camera's JPEG cannot be decoded")
        return picture


@dataclass(frozen=True, slots=True)
class PixelPicture:
    """An image that is not encoded yet."""

    held_bytes: int
    """Memory that the image takes, in bytes."""
    pixels: "Callable[[int | None], NDArray[np.uint8]]"
    """Returns BGR (H, W, 3) or grey (H, W): all pixels for None, else every nth for about that width."""

    def encode(self) -> bytes:
        """Return the image as the bytes of a JPEG of quality 95."""
        return encode_image(self.pixels(None))

    def reduced(self, width: int) -> "NDArray[np.uint8]":
        """Return the image, BGR uint8 (H, W, 3), subsampled to every nth pixel."""
        import cv2
        import numpy as np

        picture = self.pixels(width)
        return np.asarray(cv2.merge([picture] * 3), np.uint8) if picture.ndim == 2 else picture


def step_to(full: int, width: int | None) -> int:
    """Return the largest subsampling step that leaves `width` of `full` pixels; 1 if `width` is None."""
    return 1 if width is None else max(1, full // max(width, 1))


def every_nth(image: "NDArray[np.uint8]", width: int | None) -> "NDArray[np.uint8]":
    """Return the image, subsampled as in `PixelPicture.pixels`."""
    step = step_to(image.shape[1], width)
    return image[::step, ::step]


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """Memory layout of an image; sizes in pixels and bytes."""

    fourcc: str
    width: int
    height: int
    bytes_per_line: int
    buffer_bytes: int = 0
    """Maximum size of one frame in memory."""


def raw_picture(data: bytes, layout: PixelFormat) -> PixelPicture:
    """Return an uncompressed image as the driver's buffer contained it."""
    return PixelPicture(len(data), partial(_raw_pixels, data, layout))


def _raw_pixels(data: bytes, layout: PixelFormat, min_width: int | None) -> "NDArray[np.uint8]":
    import cv2
    import numpy as np

    step = step_to(layout.width, min_width)
    width, height, stride, rows = layout.width, layout.height, layout.bytes_per_line, _rows(layout)
    plane = np.frombuffer(data, np.uint8, rows * stride).reshape(rows, stride)
    if layout.fourcc == "YUYV":
        # Two pixels share their colour, so the step selects whole pairs.
        pairs = plane[:, : 2 * width].reshape(height, width // 2, 4)[::step, ::step]
        packed = np.ascontiguousarray(pairs).reshape(pairs.shape[0], pairs.shape[1] * 2, 2)
        return np.asarray(cv2.cvtColor(packed, cv2.COLOR_YUV2BGR_YUYV), np.uint8)
    if layout.fourcc == "NV12":
        picture = cv2.cvtColor(np.ascontiguousarray(plane[:, :width]), cv2.COLOR_YUV2BGR_NV12)
        return np.asarray(picture[::step, ::step], np.uint8)
    return plane[::step, :width:step]


def picture_from_buffer(data: bytes, layout: PixelFormat) -> JpegPicture | PixelPicture | None:
    """Return the image in a buffer's bytes; None if the bytes cannot be an image of that format."""
    if layout.fourcc in ("MJPG", "JPEG"):
        return JpegPicture(data) if data.startswith(JPEG_BEGIN) and is_whole_jpeg(data) else None
    return raw_picture(data, layout) if len(data) >= layout.bytes_per_line * _rows(layout) else None


def _rows(layout: PixelFormat) -> int:
    return layout.height * 3 // 2 if layout.fourcc == "NV12" else layout.height
