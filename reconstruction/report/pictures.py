"""Pictures as a page embeds them: their bytes within the page, and their size."""

import base64
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from capture_app.errors import BadInputError

KINDS = {b"\x89PNG\r\n\x1a\n": "image/png", b"\xff\xd8\xff": "image/jpeg"}


@dataclass(frozen=True)
class EmbeddedImage:
    """A picture as a `data:` address, and its size, px."""

    address: str
    width: int
    height: int


def embed(path: Path) -> EmbeddedImage:
    """Read a PNG or JPEG to be embedded unchanged.

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
    kind = next((kind for magic, kind in KINDS.items() if data.startswith(magic)), None)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if kind else None
    if image is None:
        raise BadInputError(
            f"the picture {path} is not a readable PNG or JPEG", hint="compare the session again"
        )
    address = f"data:{kind};base64,{base64.b64encode(data).decode()}"
    return EmbeddedImage(address, width=image.shape[1], height=image.shape[0])
