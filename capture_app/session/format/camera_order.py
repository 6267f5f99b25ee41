"""Order of a rig's cameras for pictures in motion: along the arc on which they stand, from left to right."""

from collections.abc import Mapping

import numpy as np

from capture_app.common.names import natural_order
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.lens import Array, centre_of, nearest_point, rotation_of

PARALLEL = 1e3
"""Condition number of the equations for the point they look at above which optical axes count as parallel."""
ONE_SPOT = 1e-9
"""Extent of the rig, in the calibration's unit, up to which all cameras stand at one place."""


def order_on_arc(cameras: Mapping[str, CameraCalibration]) -> tuple[str, ...]:
    """Return the names from left to right as the cameras see it; an arc starts after its widest gap."""
    names = sorted(cameras, key=natural_order)
    if len(names) < 2:
        return tuple(names)
    centres = np.array([centre_of(cameras[name]) for name in names])
    rotations = np.array([rotation_of(cameras[name]) for name in names])
    # Cameras at one place are distinguished by their viewing directions.
    at_one_spot = float(np.ptp(centres, axis=0).max()) <= ONE_SPOT
    places = rotations[:, 2] if at_one_spot else centres
    angles = _angles(places, -rotations[:, 2] if at_one_spot else rotations[:, 2])
    order = np.argsort(angles)
    gaps = np.diff(angles[order], append=angles[order[0]] + 2 * np.pi)
    order = np.roll(order, -int(gaps.argmax()) - 1)
    across = (places[order[-1]] - places[order[0]]) @ rotations[:, 0].mean(axis=0)
    return tuple(names[k] for k in (order[::-1] if across < 0 else order))


def _angles(centres: Array, directions: Array) -> Array:
    """Return the cameras' angles around the point that they look at, in the plane of their optical axes.

    The point is the one nearest to all optical axes; for parallel axes it is far in front of the cameras.
    """
    middle = centres.mean(axis=0)
    if (target := nearest_point(centres, directions, PARALLEL)) is None:
        target = middle + 1000 * np.abs(centres - middle).max() * directions.mean(axis=0)
    from_target = centres - target
    _, _, axes = np.linalg.svd(np.r_[from_target, centres - middle], full_matrices=False)
    return np.asarray(np.arctan2(from_target @ axes[1], from_target @ axes[0]), np.float64)
