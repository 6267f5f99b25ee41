"""The epipolar geometry of two cameras, mended by what stands still before both.

A calibration that is off by a milliradian moves what crosses its lines by a time; what stands still shows it.
"""

from dataclasses import replace

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.time_offsets.epipolar_crossings import epipolar_errors_px

LEAST_MATCHES = 60
"""Fewer of what stands still tell less than the calibration."""
FARTHEST_PX = 6.0
"""Matches that are further from their epipolar lines are wrong ones."""
PRIOR = np.array([5e-4, 5e-4, 5e-4, 1e-3, 1e-3])
"""What a calibration may be wrong by: the rotation, and the direction from camera to camera, rad."""
LEAST_SPREAD_PX = 0.15
STEP = 1e-5
ROUNDS = 8


def mend_pair(a: View, b: View, at_a: Array, at_b: Array) -> View:
    """The second view, turned and moved a little so that still matches (n, 2) px lie on their lines.

    Gauss-Newton with Cauchy weights and the prior; the distance between the cameras stays.
    """
    errors = epipolar_errors_px(a, b, at_a, at_b)
    near = np.abs(errors) < FARTHEST_PX
    if near.sum() < LEAST_MATCHES:
        return b
    at_a, at_b, change = at_a[near], at_b[near], np.zeros(5)
    for _ in range(ROUNDS):
        now = epipolar_errors_px(a, _changed(a, b, change), at_a, at_b)
        slopes = [
            (epipolar_errors_px(a, _changed(a, b, change + step), at_a, at_b) - now) / STEP
            for step in STEP * np.eye(5)
        ]
        jacobian = np.stack(slopes, axis=1)
        spread = max(LEAST_SPREAD_PX, 1.4826 * float(np.median(np.abs(now - np.median(now)))))
        weights = 1 / spread**2 / (1 + (now / (2 * spread)) ** 2)
        normal = jacobian.T @ (weights[:, None] * jacobian) + np.diag(1 / PRIOR**2)
        change = change - np.linalg.solve(normal, jacobian.T @ (weights * now) + change / PRIOR**2)
    return _changed(a, b, change)


def _changed(a: View, b: View, change: Array) -> View:
    """The second view after a rotation (3,) rad, its direction from the first changed by (2,) rad."""
    rotation = cv2.Rodrigues(change[:3])[0] @ b.rotation
    apart = b.centre - a.centre
    distance = float(np.linalg.norm(apart))
    direction = apart / distance
    beside = np.linalg.svd(direction[None])[2][1:]
    direction = direction + beside.T @ change[3:]
    centre = a.centre + distance * direction / np.linalg.norm(direction)
    return replace(b, rotation=rotation, translation=-rotation @ centre)
