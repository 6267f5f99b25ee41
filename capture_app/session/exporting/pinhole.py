"""Pinhole lenses for programs that know no other: centred, undistorted, and filled by the camera's image."""

import math
from collections.abc import Mapping
from itertools import product

import numpy as np
from msgspec import UNSET, structs

from capture_app.common.errors import BadInputError
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.format.lens import (
    Array,
    centre_of,
    lens_of,
    nearest_point,
    rotation_of,
)

STRAIGHT_DEG = 100.0
"""Largest field of view, along the longer side, for which a fisheye's images are redrawn."""
_NARROWER = 0.99
"""Step factor in the search for a field of view."""


def centred_pinhole(camera: CameraCalibration, width: int, height: int, focal: float) -> CameraCalibration:
    """Return a camera at the same pose with `focal` px, no distortion and a centred principal point."""
    lens = {"fx": focal, "fy": focal, "cx": (width - 1) / 2, "cy": (height - 1) / 2}
    return structs.replace(camera, width=width, height=height, distortion=(0.0,) * 5, model=UNSET, **lens)


def nearest_pinhole(camera: CameraCalibration) -> CameraCalibration:
    """Return the pinhole lens of a camera's size that its image fills with the widest view.

    Without distortion the image is only cropped, by whole pixels, until the principal point is within 0.25
    px of the middle.
    """
    if not lens_of(camera).is_straight:
        size = camera.width, camera.height
        return centred_pinhole(camera, *size, min_focal(camera, *size))
    left, width = _centred_span(camera.cx, camera.width)
    top, height = _centred_span(camera.cy, camera.height)
    if min(width, height) < 2:
        raise _outside(camera)
    return structs.replace(camera, width=width, height=height, cx=camera.cx - left, cy=camera.cy - top)


def common_pinhole(
    cameras: Mapping[str, CameraCalibration], size: tuple[int, int] | None = None
) -> dict[str, CameraCalibration]:
    """Return one pinhole lens for all cameras, at the pose of each, that all images fill.

    Cameras that share such a lens of this size (width, height; None = of the smallest image) keep it.
    """
    ours = {name: nearest_pinhole(camera) for name, camera in cameras.items()}
    smallest = min(camera.width for camera in ours.values()), min(camera.height for camera in ours.values())
    width, height = size or smallest
    lenses = {(camera.width, camera.height, camera.fx, camera.fy) for camera in ours.values()}
    drawn = not all(lens_of(camera).is_straight for camera in cameras.values())
    focal = next(iter(lenses))[2]
    if not drawn and lenses == {(width, height, focal, focal)}:
        return ours
    focal = max(min_focal(camera, width, height) for camera in cameras.values())
    return {name: centred_pinhole(camera, width, height, focal) for name, camera in cameras.items()}


def straight_lens(fisheye: CameraCalibration) -> CameraCalibration:
    """Return the perspective lens for which a fisheye's images are redrawn, at most `STRAIGHT_DEG` wide.

    It has the fisheye's size. Its field, along the longer side, is smaller if the image does not fill it.
    """
    size = fisheye.width, fisheye.height
    widest = max(size) / 2 / math.tan(math.radians(STRAIGHT_DEG) / 2)
    return centred_pinhole(fisheye, *size, max(widest, min_focal(fisheye, *size)))


def min_focal(camera: CameraCalibration, width: int, height: int) -> float:
    """Return the shortest focal length, px, at which the camera's image fills a picture of this size.

    The picture is a pinhole's with a centred principal point. Raises BadInputError if none is filled.
    """
    across, down = np.linspace(-width / 2, width / 2, 41), np.linspace(-height / 2, height / 2, 41)
    edge = np.array([*product(across, down[[0, -1]]), *product(across[[0, -1]], down)])
    lens, half = lens_of(camera), np.array([camera.width, camera.height]) / 2

    def fills(focal: float) -> bool:
        return bool((np.abs(lens.project(edge / focal) - (half - 0.5)) <= half + 1e-6).all())

    # Search from a narrow view outwards: far outside its image a lens's polynomial may map rays back into it.
    focal = 100 * max(width / camera.width, height / camera.height) * max(camera.fx, camera.fy)
    if not fills(focal):
        raise _outside(camera)
    while fills(focal * _NARROWER):
        focal *= _NARROWER
    low, high = focal * _NARROWER, focal
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (low, middle) if fills(middle) else (middle, high)
    return high


def focus_depths(cameras: Mapping[str, CameraCalibration]) -> dict[str, float]:
    """Return for each camera the depth, in the calibration's unit, of the point nearest to all optical axes.

    If the axes do not meet in front of the cameras, it is ten times the largest distance between two cameras.
    """
    centres = np.array([centre_of(camera) for camera in cameras.values()])
    axes = np.array([rotation_of(camera)[2] for camera in cameras.values()])
    widest = max((float(np.linalg.norm(a - b)) for a in centres for b in centres), default=0.0)
    if (point := nearest_point(centres, axes, 1e4)) is not None:
        depths = np.einsum("nj,nj->n", axes, point - centres)
        if depths.min() > 0:
            return dict(zip(cameras, map(float, depths), strict=True))
    return dict.fromkeys(cameras, 10 * widest or 1.0)


def llff_row(camera: CameraCalibration, near: float, far: float) -> Array:
    """Return LLFF's 17 numbers of a camera (Mildenhall et al. 2019).

    They are a 3 x 5 matrix of its down, right and back axes, its centre, and (height, width, focal), then the
    nearest and the farthest depth.
    """
    right, down, forward = rotation_of(camera)
    intrinsics = np.array([camera.height, camera.width, camera.fx], np.float64)
    pose = np.stack([down, right, -forward, centre_of(camera), intrinsics], axis=1)
    return np.array([*pose.ravel(), near, far], np.float64)


def opengl_pose(camera: CameraCalibration) -> Array:
    """Return a camera's pose (4 x 4, rig from camera) in OpenGL's axes: x right, y up, z back."""
    pose = np.column_stack([rotation_of(camera).T * [1.0, -1.0, -1.0], centre_of(camera)])
    return np.vstack([pose, [0.0, 0.0, 0.0, 1.0]])


def _centred_span(centre: float, length: int) -> tuple[int, int]:
    """Return begin and length, px, of the largest span of an image that is centred on a coordinate."""
    off = round(2 * centre - (length - 1))
    return max(off, 0), length - abs(off)


def _outside(camera: CameraCalibration) -> BadInputError:
    return BadInputError(
        f"no centred lens has a principal point outside the picture, ({camera.cx:.0f}, {camera.cy:.0f})",
        hint="calibrate again",
    )
