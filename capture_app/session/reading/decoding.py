"""Decodes and encodes image files."""

from typing import TYPE_CHECKING, Any

from capture_app.common.errors import BadInputError
from capture_app.session.reading.file_headers import size_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

MOST_PIXELS = 1 << 28
"""The largest image that is decoded: more than any camera takes."""
JPEG_QUALITY = 95


def decode_image(
    data: bytes, *, colour: bool = False, at_least: int = 0, upright: bool = False
) -> "NDArray[np.uint8] | None":
    """Decode an image file's bytes in full; None where they are not an image.

    Nor are those of more than MOST_PIXELS, which a small file can tell of.
    `colour`: height x width x BGR of 8 bits, whatever the file has; with `at_least` a half, a quarter or an
    eighth of its size where that is still so wide, which takes far less time. `upright`: of 8 bits and turned
    as its EXIF says, which no other image is.
    """
    told = size_of(data)
    if told is not None and told[0] * told[1] > MOST_PIXELS:
        return None
    import cv2  # heavy: only where images are looked at
    import numpy as np

    flags = cv2.IMREAD_ANYCOLOR if upright else cv2.IMREAD_UNCHANGED
    if colour:
        sizes = (
            (8, cv2.IMREAD_REDUCED_COLOR_8),
            (4, cv2.IMREAD_REDUCED_COLOR_4),
            (2, cv2.IMREAD_REDUCED_COLOR_2),
        )
        fitting = (flag for by, flag in sizes if told and at_least and told[0] >= by * at_least)
        flags = next(fitting, cv2.IMREAD_COLOR) | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data else None
    except cv2.error:
        return None
    return image


def image_size(data: bytes) -> tuple[int, int] | None:
    """Width and height in pixels of an image file's bytes, decoded in full; None if they are not an image."""
    image = decode_image(data)
    return None if image is None else (image.shape[1], image.shape[0])


def encode_image(image: "NDArray[np.uint8]", suffix: str = ".jpg", quality: int = JPEG_QUALITY) -> bytes:
    """The bytes of an image's file, as the suffix says; `quality` of a JPEG. Raises BadInputError."""
    import cv2

    options = [cv2.IMWRITE_JPEG_QUALITY, quality] if suffix == ".jpg" else []
    made, data = cv2.imencode(suffix, image, options)
    if not made:
        raise BadInputError(f"the picture cannot be written as {suffix[1:].upper()}")
    return bytes(data.tobytes())


def open_capture(source: str | int) -> Any:
    """OpenCV's reader of a video's path or a webcam's number, perhaps not open; it says nothing itself."""
    import cv2

    before = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        return cv2.VideoCapture(source)
    finally:
        cv2.utils.logging.setLogLevel(before)
