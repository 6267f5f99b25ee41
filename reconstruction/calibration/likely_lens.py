"""How long a camera's focal length likely is: what structure from motion starts from."""

import math
from collections.abc import Mapping

from capture_app.errors import NotApplicableError
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.reading.exif import read_exif
from reconstruction.session.dataset import Dataset

FILM_DIAGONAL_MM = 43.27
"""Of 36 x 24 mm, which equivalent focal lengths are for (CIPA DC-008)."""
MAX_FOCAL_RATIO = 1.25
"""Equivalent focal lengths are whole millimetres, and lenses' data sheets rounded."""
WIDEST_DEG = 100.0


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


def refuse_odd_lenses(found: Mapping[str, CameraCalibration], focal_px: Mapping[str, float]) -> None:
    """Refuse focal lengths that structure from motion cannot have found, only guessed.

    Little depth in what stands still leaves a focal length nearly free, however well the points fit.

    Raises:
        NotApplicableError: a lens is far from what it likely is, or sees wider than plain lenses do.
    """
    for name, camera in found.items():
        view_deg = field_of_view_deg(camera)
        likely = focal_px.get(name)
        if likely is not None and not 1 / MAX_FOCAL_RATIO < camera.fx / likely < MAX_FOCAL_RATIO:
            likely_deg = math.degrees(2 * math.atan(camera.width / 2 / likely))
            raise NotApplicableError(
                f"{name} would see {view_deg:.0f} degrees wide, not {likely_deg:.0f} as it likely does: "
                "what stands still shows too little depth to tell",
                hint="calibrate with a board; or is --field-of-view, or the pictures' EXIF, wrong?",
            )
        if likely is None and view_deg > WIDEST_DEG:
            raise NotApplicableError(
                f"{name} would see {view_deg:.0f} degrees wide, which is unlikely: "
                "what stands still shows too little depth to tell",
                hint="say how wide it sees with --field-of-view, or calibrate with a board",
            )


def field_of_view_deg(camera: CameraCalibration) -> float:
    """How wide a camera sees, from the left to the right edge."""
    return math.degrees(2 * math.atan(camera.width / 2 / camera.fx))
