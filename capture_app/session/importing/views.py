"""The cameras of a calibration file, in one form for all formats: read by name, and told apart by image."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from capture_app.common.errors import BadInputError

Array = NDArray[np.float64]
SAME_ROTATION, SAME_PLACE = 1e-5, 1e-5
"""Largest difference of two rotation matrices, and of two places as a share of the rig's extent."""


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
    """The unit where neither the file nor the user says one: `arbitrary` of formats that know no scale."""


def read_json(path: Path) -> Any:
    """What a .json file holds; None for any other. Raises BadInputError where it cannot be read."""
    if path.suffix.lower() != ".json":
        return None
    try:
        return msgspec.json.decode(path.read_bytes())
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror}") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path} is not JSON: {error}") from error


def numbers(
    where: str, content: Mapping[Any, Any], key: str, *counts: int, hint: str = "is the calibration complete?"
) -> Array:
    """The numbers at a key, in one row. Raises BadInputError where they lack or cannot be."""
    if content.get(key) is None:
        raise BadInputError(f"{where} has no {key}", hint=hint)
    try:
        values = np.asarray(content[key], np.float64).ravel()
    except (TypeError, ValueError):
        raise BadInputError(f"{where}: {key} is not made of numbers") from None
    if values.size not in counts:
        raise BadInputError(f"{where}: {key} has {values.size} numbers, not {' or '.join(map(str, counts))}")
    if not np.isfinite(values).all():
        raise BadInputError(f"{where}: {key} has numbers that are not finite")
    return values


def pinhole(fx: float, fy: float, cx: float, cy: float) -> Array:
    """The camera matrix, 3x3, of focal lengths and a principal point in pixels."""
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)


def rotation_of(where: str, values: Array) -> Array:
    """The rotation matrix (3x3) of as many numbers, a quaternion (w, x, y, z) or a Rodrigues vector.

    Raises BadInputError, beginning with `where`, for a quaternion of length 0 or that is not finite.
    """
    if values.size == 4:
        return from_quaternion(where, values)
    if values.size == 3:
        import cv2

        return np.asarray(cv2.Rodrigues(values.reshape(3, 1))[0], np.float64)
    return values.reshape(3, 3)


def view_at(
    where: str,
    k: Sequence[float],
    d: Sequence[float],
    wxyz: Sequence[float],
    centre: Sequence[float],
    size: tuple[int, int],
) -> View:
    """The view of a camera by its matrix (9 numbers), distortion (or none), turn and place in the world.

    Raises BadInputError, beginning with `where`, for anything else.
    """
    if len(k) != 9:
        raise BadInputError(f"{where} has a calibration without K")
    rotation = from_quaternion(where, wxyz).T
    return View(
        matrix=np.array(k).reshape(3, 3),
        distortion=np.array(d if len(d) else [0.0] * 5),
        rotation=rotation,
        translation=-rotation @ np.array(centre),
        size=size,
    )


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
    rest = [(name, view) for name, view in images if views.setdefault(name, view) is not view]
    extent = max((float(np.linalg.norm(view.translation)) for view in views.values()), default=0.0)
    for name, view in rest:
        if not _same_view(views[name], view, extent):
            raise BadInputError(f"{where}: camera {name} is not in one place in all of its images", hint=hint)
    return views


def _same_view(one: View, other: View, extent: float) -> bool:
    """Whether two views have one pose and one lens; `extent` is the rig's, in the unit of translations."""
    return (
        one.size == other.size
        and np.array_equal(one.matrix, other.matrix)
        and np.array_equal(one.distortion, other.distortion)
        and bool(np.abs(one.rotation - other.rotation).max() <= SAME_ROTATION)
        and bool(np.abs(one.translation - other.translation).max() <= SAME_PLACE * extent)
    )
