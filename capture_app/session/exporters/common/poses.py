"""A calibrated camera's numbers in the conventions of other programs."""

import math

import numpy as np
from numpy.typing import NDArray

from capture_app.session.format.calibration import CameraCalibration

Array = NDArray[np.float64]


def rotation_of(camera: CameraCalibration) -> Array:
    """Rotation of `cam_from_rig`, 3x3."""
    return np.array(camera.rotation, np.float64)


def translation_of(camera: CameraCalibration) -> Array:
    """Translation of `cam_from_rig`, (3,), in the calibration's unit."""
    return np.array(camera.translation, np.float64)


def centre_of(camera: CameraCalibration) -> Array:
    """Position of the camera in the rig's coordinates, (3,), in the calibration's unit."""
    return np.asarray(-rotation_of(camera).T @ translation_of(camera))


def matrix_of(camera: CameraCalibration) -> Array:
    """OpenCV's camera matrix, 3x3, in pixels; the first pixel's centre is (0, 0)."""
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], np.float64)


def distortion_of(camera: CameraCalibration) -> Array:
    """OpenCV's k1, k2, p1, p2, k3."""
    given = camera.distortion[:5]
    return np.array([*given, *[0.0] * (5 - len(given))], np.float64)


def quaternion(rotation: Array) -> tuple[float, float, float, float]:
    """Unit quaternion (w, x, y, z), w >= 0, of a rotation matrix (Horn 1987, section 4)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation
    symmetric = np.array(
        [
            [xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, xx - yy - zz, xy + yx, xz + zx],
            [xz - zx, xy + yx, yy - xx - zz, yz + zy],
            [yx - xy, xz + zx, yz + zy, zz - xx - yy],
        ]
    )
    w, x, y, z = map(float, np.linalg.eigh(symmetric).eigenvectors[:, -1])
    return (w, x, y, z) if w >= 0 else (-w, -x, -y, -z)


def rodrigues(rotation: Array) -> tuple[float, float, float]:
    """Rotation vector in radians of a rotation matrix."""
    w, x, y, z = quaternion(rotation)
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 if sine < 1e-12 else 2 * math.atan2(sine, w) / sine
    return x * scale, y * scale, z * scale
