"""A rig of two cameras with known lenses and poses, and where a calibration that was read has points."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.session.importing.calibrations import fit_calibration, read_views

SIZE = (640, 480)
D = np.array([-0.12, 0.03, 0.002, -0.001, 0.0])
POINTS = np.array([[0.1, -0.2, 3.0], [-0.4, 0.3, 2.5], [0.6, 0.1, 4.0]])
Array = np.ndarray[Any, Any]


def lens(n: int) -> Array:
    return np.array([[600.0 + n, 0, 330.25], [0, 610.0 + n, 235.5], [0, 0, 1]])


def pose(n: int) -> tuple[Array, Array]:
    return cv2.Rodrigues(np.array([0.1 * n, -0.2 * n, 0.05]))[0], np.array([-0.3 * n, 0.02, 0.1 * n])


def read(*paths: Path, names: tuple[str, ...] = ("cam0", "cam1"), **options: Any) -> Calibration:
    sizes = dict.fromkeys(names, SIZE)
    return fit_calibration(read_views([("", path) for path in paths], names), sizes, **options)


def see(camera: CameraCalibration) -> Array:
    """Where this calibration has the points, in pixels whose first has its centre at (0, 0)."""
    rotation = cv2.Rodrigues(np.array(camera.rotation))[0]
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    pixels, _ = cv2.projectPoints(
        POINTS, rotation, np.array(camera.translation), matrix, np.array(camera.distortion)
    )
    return np.asarray(pixels).reshape(-1, 2)
