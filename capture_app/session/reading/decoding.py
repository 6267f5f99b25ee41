"""Image decoding and encoding with OpenCV."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from capture_app.common.errors import BadInputError
from capture_app.session.reading.file_headers import size_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

MAX_PIXELS = 1 << 28
"""Largest stored image that is decoded, px; no camera takes a larger one."""
MAX_SENT_PIXELS = 1 << 24
"""Largest preview that is decoded, px: eight times the largest one asked for; it takes up to 150 MB."""
JPEG_QUALITY = 95


def decode_image(
    data: bytes,
    *,
    colour: bool = False,
    min_width: int = 0,
    upright: bool = False,
    max_pixels: int = MAX_PIXELS,
) -> "NDArray[np.uint8] | None":
    """Decode an image file's bytes; return None if they are not an image or if it exceeds `max_pixels`.

    A small file can claim a huge size, so a file whose header gives no size is not decoded. `colour`: return
    height x width x BGR of 8 bits, whatever the file contains; with `min_width`, decode at a half, a quarter
    or an eighth of the size as long as the width stays at least that, which is faster. `upright`: 8 bits,
    rotated by the EXIF orientation; otherwise the orientation is ignored.
    """
    size = size_of(data)
    if size is None or not 0 < size[0] * size[1] <= max_pixels:
        return None
    import cv2  # heavy: imported only when an image is decoded
    import numpy as np

    flags = cv2.IMREAD_ANYCOLOR if upright else cv2.IMREAD_UNCHANGED
    if colour:
        sizes = (
            (8, cv2.IMREAD_REDUCED_COLOR_8),
            (4, cv2.IMREAD_REDUCED_COLOR_4),
            (2, cv2.IMREAD_REDUCED_COLOR_2),
        )
        fitting = (flag for by, flag in sizes if min_width and size[0] >= by * min_width)
        flags = next(fitting, cv2.IMREAD_COLOR) | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data else None
    except cv2.error:
        return None
    return image


def decode_preview(data: bytes) -> "NDArray[np.uint8] | None":
    """Decode a preview or a phone's picture as BGR, as `decode_image` does up to MAX_SENT_PIXELS."""
    return decode_image(data, colour=True, max_pixels=MAX_SENT_PIXELS)


def image_size(data: bytes) -> tuple[int, int] | None:
    """Decode an image file's bytes and return width and height in px; None if they are not an image."""
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


def open_capture(source: str | int) -> Any:
    """Return OpenCV's reader for a video path or a webcam number; it may not be open. Logs nothing."""
    import cv2

    before = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        # A pipe would be waited for without an end.
        is_pipe = isinstance(source, str) and Path(source).is_fifo()
        return cv2.VideoCapture() if is_pipe else cv2.VideoCapture(source)
    finally:
        cv2.utils.logging.setLogLevel(before)
