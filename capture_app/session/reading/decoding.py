"""Decodes image files."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def decode_image(data: bytes, *, colour: bool = False, reduction: int = 1) -> "NDArray[np.uint8] | None":
    """Decode an image file's bytes in full, without turning it by EXIF; None where they are not an image.

    `colour`: height x width x BGR of 8 bits, whatever the file has. `reduction`, of a coloured one only:
    a half, quarter or eighth of its size (2, 4 or 8), which takes far less time.
    """
    import cv2  # heavy: only where images are looked at
    import numpy as np

    of_size = {
        1: cv2.IMREAD_COLOR,
        2: cv2.IMREAD_REDUCED_COLOR_2,
        4: cv2.IMREAD_REDUCED_COLOR_4,
        8: cv2.IMREAD_REDUCED_COLOR_8,
    }
    flags = of_size[reduction] | cv2.IMREAD_IGNORE_ORIENTATION if colour else cv2.IMREAD_UNCHANGED
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data else None
    except cv2.error:
        return None
    return image


def image_size(data: bytes) -> tuple[int, int] | None:
    """Width and height in pixels of an image file's bytes, decoded in full; None if they are not an image."""
    image = decode_image(data)
    return None if image is None else (image.shape[1], image.shape[0])
