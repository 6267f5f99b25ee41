"""Cameras of a calibration, in one form.

The cameras of a calibration file, in one form for all file formats.

Poses that a format gives to images: of a rig that stands still they are its cameras'.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from capture_app.errors import BadInputError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One camera of a calibration file: 3x3 matrix in pixels, OpenCV distortion, and x_cam = R x_rig + t.

    `rotation` is 3x3, `translation` (3,) in the file's unit; `size` is (width, height) in pixels, None
    where the file does not say. The first pixel's centre is (0, 0).
    """

    matrix: Array
    distortion: Array
    rotation: Array
    translation: Array
    size: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """All cameras of a file by the file's own labels; `unit` is the format's, None where it has none."""

    cameras: Mapping[str, View]
    source: str
    unit: str | None = None
    assumed_unit: str = "m"
    """Where neither the file nor the user says: `arbitrary` of formats that know no scale."""


def from_quaternion(where: str, wxyz: Sequence[float] | Array) -> Array:
    """Rotation matrix (3x3) of a quaternion (w, x, y, z), not necessarily of length 1 (Horn 1987).

    Raises BadInputError, beginning with `where`, for one of length 0 or that is not finite.
    """
    quaternion = np.asarray(wxyz, np.float64)
    length = float(np.linalg.norm(quaternion))
    if not 1e-9 < length < 1e9:
        raise BadInputError(f"{where} has the rotation {list(wxyz)}, which is no quaternion")
    w, x, y, z = quaternion / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def from_rodrigues(vector: Array) -> Array:
    """Rotation matrix (3x3) of a Rodrigues vector (3,), in radians."""
    import cv2

    return np.asarray(cv2.Rodrigues(vector.reshape(3, 1))[0], np.float64)


SAME_ROTATION, SAME_PLACE = 1e-5, 1e-5
"""Largest difference of two rotation matrices, and of two places as a share of the rig's extent."""


def camera_of(image: str, cameras: Sequence[str]) -> str:
    """The camera that an image's path is of: a part of it that is a camera's name, else its folder's name.

    Of an image in no folder it is its own name without the ending: one picture a camera. Raises
    BadInputError for a path without a name.
    """
    path = PurePosixPath(image.replace("\\", "/"))
    if not path.name:
        raise BadInputError(f"{image!r} is no path of an image")
    parts = path.with_suffix("").parts
    names = {name.casefold(): name for name in cameras}
    for part in reversed(parts):
        if part.casefold() in names:
            return names[part.casefold()]
    return parts[-2] if len(parts) > 1 else parts[-1]


def views_of_images(where: str, images: Iterable[tuple[str, View]], hint: str) -> dict[str, View]:
    """The one view of each camera, of images as (camera, view).

    Raises BadInputError, beginning with `where`, for a camera that moves between its images or changes.
    """
    views: dict[str, View] = {}
    rest: list[tuple[str, View]] = []
    for name, view in images:
        if views.setdefault(name, view) is not view:
            rest.append((name, view))
    extent = max((float(np.linalg.norm(view.translation)) for view in views.values()), default=0.0)
    for name, view in rest:
        if not same_view(views[name], view, extent):
            raise BadInputError(f"{where}: camera {name} is not in one place in all of its images", hint=hint)
    return views


def same_view(one: View, other: View, extent: float) -> bool:
    """Whether two views have one pose and one lens; `extent` is the rig's, in the unit of translations."""
    return (
        one.size == other.size
        and np.array_equal(one.matrix, other.matrix)
        and np.array_equal(one.distortion, other.distortion)
        and bool(np.abs(one.rotation - other.rotation).max() <= SAME_ROTATION)
        and bool(np.abs(one.translation - other.translation).max() <= SAME_PLACE * extent)
    )
