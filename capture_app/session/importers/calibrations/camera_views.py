"""The cameras of a calibration file, in one form for all file formats."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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
