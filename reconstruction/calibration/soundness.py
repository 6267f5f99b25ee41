"""Whether a calibration can be of real cameras: what no lens and no rig can have is refused by name."""

import numpy as np

from capture_app.errors import BadInputError
from capture_app.session.format.calibration import CameraCalibration
from reconstruction.common.geometry import View

FOCAL_LIMITS = (0.05, 200.0)
"""Focal length in widths of the picture: a fisheye's is a third, a telescope's some hundred."""
MAX_ASPECT = 4.0
"""Of the two focal lengths: pixels of a squeezed picture are two to one."""
MAX_CENTRE = 3.0
"""How far off the picture's middle the lens may look, in pictures."""
MAX_UNEVEN = 1e-3
"""Of the rotation times its transpose to the identity."""
MAX_REACH = 1e12
"""Distance of a camera from the origin, in units of the calibration."""
MAX_FOLD = 0.1
"""How far off the border's pixels may come back from undistorting and distorting, in sizes of the picture.

The median counts: the model of many a wide lens folds in the very corners."""

MAX_STRETCH = 8.0
"""How much wider or narrower a picture may become without its distortion."""


def refuse_unsound(name: str, camera: CameraCalibration) -> None:
    """Raise BadInputError, with the number, where a camera's calibration can be of no camera."""
    why = _problem(camera)
    if why:
        raise BadInputError(
            f"the calibration of camera {name} cannot be right: {why}",
            hint="calibrate the rig anew, or mend calibration.json",
        )


def _problem(camera: CameraCalibration) -> str:
    """What cannot be of a calibration; empty where nothing is."""
    rotation, translation = np.array(camera.rotation), np.array(camera.translation)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion])
    if not all(np.isfinite(numbers).all() for numbers in (rotation, translation, lens)):
        return "it has numbers that are not finite"
    if min(camera.width, camera.height) < 1:
        return f"it is for pictures of {camera.width}x{camera.height} pixels"
    return _lens_problem(camera) or _pose_problem(camera) or _distortion_problem(camera)


def _lens_problem(camera: CameraCalibration) -> str:
    widest = max(camera.width, camera.height)
    for focal in (camera.fx, camera.fy):
        if not FOCAL_LIMITS[0] * widest <= focal <= FOCAL_LIMITS[1] * widest:
            return f"a focal length of {focal:g} px for pictures of {camera.width}x{camera.height}"
    if not 1 / MAX_ASPECT <= camera.fx / camera.fy <= MAX_ASPECT:
        return f"focal lengths of {camera.fx:g} px across and {camera.fy:g} px down"
    if max(abs(camera.cx / camera.width - 0.5), abs(camera.cy / camera.height - 0.5)) > MAX_CENTRE:
        return f"its principal point is ({camera.cx:g}, {camera.cy:g}), far outside the picture"
    return ""


def _pose_problem(camera: CameraCalibration) -> str:
    rotation = np.array(camera.rotation)
    with np.errstate(over="ignore", invalid="ignore"):
        uneven = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
        reach = float(np.abs(camera.translation).max())
    if not uneven <= MAX_UNEVEN:
        return (
            f"its rotation matrix is not a rotation: unit length or right angles are missed by {uneven:.2g}"
        )
    if np.linalg.det(rotation) < 0:
        return "its rotation is mirrored (determinant -1)"
    if reach > MAX_REACH:
        return f"it stands {reach:.2g} units away"
    return ""


def _distortion_problem(camera: CameraCalibration) -> str:
    if len(camera.distortion) > 5 and any(camera.distortion[5:]):
        return f"its distortion has {len(camera.distortion)} numbers; k1, k2, p1, p2 and k3 are understood"
    view = View.from_calibration(camera, camera.width, camera.height)
    border = view.border(8)
    with np.errstate(all="ignore"):
        rays = view.rays(border)
        off = float(np.median(np.abs(view.project(rays) - border).max(1)))
    if not off <= MAX_FOLD * max(view.width, view.height):
        return f"its distortion folds the picture (pixels at the border come back {off:.3g} px off)"
    plain = np.linalg.norm((border - view.matrix[:2, 2]) / np.diagonal(view.matrix)[:2], axis=1)
    # The principal point itself, where it lies on the border, has no stretch.
    away = plain > 1e-6
    stretch = float(np.median(np.linalg.norm(rays[away, :2], axis=1) / plain[away]))
    if not 1 / MAX_STRETCH <= stretch <= MAX_STRETCH:
        return f"without its distortion the picture would be {stretch:.2g} times as wide"
    return ""
