"""Pictures read from files and written to files, with the errors that OpenCV does not raise."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from capture_app.errors import BadInputError
from reconstruction.common.geometry import Array

FAST_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)
"""For pictures that are read once and deleted."""
JPEG_QUALITY = 92


def read_image(path: Path) -> Array:
    """A picture's colours, uint8 height x width x 3, BGR.

    Raises:
        BadInputError: it is not an image, or its format is not supported.
    """
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise BadInputError(f"{path} is not an image, or its format is not supported")
    return np.asarray(image, np.uint8)


def write_image(path: Path, image: Array, parameters: Sequence[int] = ()) -> None:
    """Write a picture in the format of the file's suffix; `parameters` are OpenCV's.

    Raises:
        OSError: it cannot be written. `cv2.imwrite` does not tell of a full disk.
    """
    path.write_bytes(cv2.imencode(path.suffix, image, parameters)[1].tobytes())


def save_picture(folder: Path, name: str, picture: Array, *, quality: int = JPEG_QUALITY) -> str:
    """Write a picture into folder/pictures; its path relative to the folder. `quality` is for JPEG."""
    target = folder / "pictures" / name
    target.parent.mkdir(parents=True, exist_ok=True)
    write_image(target, picture, [cv2.IMWRITE_JPEG_QUALITY, quality] if target.suffix == ".jpg" else [])
    return f"pictures/{name}"
