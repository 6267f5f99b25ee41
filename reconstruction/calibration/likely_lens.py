"""How long a camera's focal length likely is: what structure from motion starts from."""

import math

from capture_app.session.reading.exif import read_exif
from reconstruction.session.dataset import Dataset

FILM_DIAGONAL_MM = 43.27
"""Of 36 x 24 mm, which equivalent focal lengths are for (CIPA DC-008)."""


def likely_focal_lengths(dataset: Dataset, field_of_view_deg: float | None = None) -> dict[str, float]:
    """Focal lengths in px by camera: by the horizontal field of view, else by the EXIF of their pictures."""
    found = {}
    for name in dataset.cameras:
        width, height = dataset.size(name)
        if field_of_view_deg is not None:
            found[name] = width / 2 / math.tan(math.radians(field_of_view_deg) / 2)
        elif (focal_35mm := _exif_focal_35mm(dataset, name)) is not None:
            found[name] = focal_35mm / FILM_DIAGONAL_MM * math.hypot(width, height)
    return found


def _exif_focal_35mm(dataset: Dataset, camera: str) -> int | None:
    for instant in dataset.instants(camera)[:1]:
        try:
            return read_exif(dataset.image_bytes(camera, instant)).focal_35mm
        except (OSError, ValueError):
            return None
    return None
