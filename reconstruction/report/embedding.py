"""Pictures inside a page: as `data:` addresses, in a form that keeps the page small enough to be sent."""

import base64
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from capture_app.errors import BadInputError
from reconstruction.common.geometry import Array

PNG, JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"
QUALITY = 74
"""Of photographs, as WebP."""
LOSSLESS = 101
"""OpenCV's word for a WebP without loss: flat colours and hard edges stay as they are."""
MAX_PANEL_PX = 1024
"""What is wider is made smaller: no page shows more."""


@dataclass(frozen=True)
class EmbeddedImage:
    """A picture as a `data:` address, and its size, px."""

    address: str
    width: int
    height: int


def embed_image(path: Path, panels: int = 1, most_px: int = MAX_PANEL_PX) -> EmbeddedImage:
    """Read a PNG or JPEG and pack it for a page, each of its `panels` side by side `most_px` wide at most.

    Raises:
        BadInputError: the file is missing, or is no PNG or JPEG.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BadInputError(
            f"the report lacks the picture {path}: {error.strerror or error}",
            hint="compare the session again",
        ) from error
    known = data.startswith((PNG, JPEG))
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if known else None
    if image is None:
        raise BadInputError(
            f"the picture {path} is not a readable PNG or JPEG", hint="compare the session again"
        )
    shown = _shrink(image, most_px * panels)
    quality = LOSSLESS if data.startswith(PNG) else QUALITY
    _, packed = cv2.imencode(".webp", shown, [cv2.IMWRITE_WEBP_QUALITY, quality])
    address = f"data:image/webp;base64,{base64.b64encode(packed.tobytes()).decode()}"
    return EmbeddedImage(address, width=shown.shape[1], height=shown.shape[0])


def _shrink(image: Array, most: int) -> Array:
    height, width = image.shape[:2]
    if width <= most:
        return np.asarray(image)
    size = (most, max(1, round(height * most / width)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
