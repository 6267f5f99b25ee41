"""Pictures read from files and written to files, with the errors that OpenCV does not raise."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from capture_app.errors import BadInputError
from reconstruction.common.geometry import Array

FAST_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)
"""For pictures that are read once and deleted."""


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
