"""Masks of movers: white where something moves, as `reconstruct movers` writes them."""

from pathlib import Path

import numpy as np

from capture_app.errors import BadInputError, IncompleteError
from capture_app.session.exporters.common.exported_burst import ExportedBurst, Picture, Redraw
from capture_app.session.format.manifest import ImageRecord


def mask_path(folder: Path, camera: str, instant: int) -> Path:
    """Where an image's mask lies in a folder of masks."""
    return folder / camera / f"{instant:06d}.png"


def write_mask(
    burst: ExportedBurst,
    folder: Path,
    image: ImageRecord,
    target: Path,
    *,
    movers: int,
    redraw: Redraw | None = None,
) -> None:
    """Write an image's mask as PNG with `movers`, 0 or 255, where something moves, else the other.

    Raises IncompleteError where the folder lacks it, BadInputError where it is not of the image's size.
    """
    import cv2

    path = mask_path(folder, image.camera, image.instant)
    if not path.is_file():
        raise IncompleteError(f"{path} is missing", hint="reconstruct movers makes masks of all images")
    mask = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_GRAYSCALE)
    if mask is None or mask.shape[::-1] != burst.size(image.camera):
        size = "x".join(map(str, burst.size(image.camera)))
        raise BadInputError(f"{path} is not a picture of {size} pixels")
    white: Picture = np.where(mask > 127, 255, 0).astype(np.uint8)
    if redraw:
        white = np.where(redraw(white) > 127, 255, 0).astype(np.uint8)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(cv2.imencode(".png", white if movers else 255 - white)[1].tobytes())
