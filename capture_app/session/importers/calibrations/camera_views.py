"""The cameras of a calibration file, in one form for all file formats."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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


def from_rodrigues(vector: Array) -> Array:
    """Rotation matrix (3x3) of a Rodrigues vector (3,), in radians."""
    import cv2

    return np.asarray(cv2.Rodrigues(vector.reshape(3, 1))[0], np.float64)
