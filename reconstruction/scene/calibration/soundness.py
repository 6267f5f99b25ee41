"""Whether real cameras can have a calibration, and the views of those that can."""

from collections.abc import Container, Mapping, Sequence
from itertools import chain, combinations

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.format.calibration import Calibration, CameraCalibration
from reconstruction.common.geometry import View
from reconstruction.scene.dataset import Dataset

FOCAL_LIMITS = (0.05, 200.0)
"""Minimum and maximum focal length, in longer sides of the image: a fisheye has 1/3, a telescope some 100."""
MAX_ASPECT = 4.0
"""Maximum ratio of the two focal lengths; pixels of an anamorphic image are 2:1."""
MAX_CENTRE = 3.0
"""Maximum distance of the principal point from the image's middle, in image sizes."""
MAX_UNEVEN = 1e-3
"""Maximum difference between the rotation times its transpose and the identity."""
MAX_CAMERA_DISTANCE = 1e12
"""Maximum distance of a camera from the origin, in the calibration's unit."""
MAX_FOLD = 0.1
"""Maximum error of border pixels after undistorting and distorting, as a fraction of the image size.

The limit applies to the median, as the model of many wide lenses folds in the extreme corners."""

SAME_FRACTION = 1e-6
"""Relative difference below which poses are equal; positions relative to the rig's extent from its origin."""
NEIGHBOURS_M = 5e-4, 150.0
"""Minimum and maximum distance between neighbouring cameras, metres."""
MAX_STRETCH = 8.0
"""Maximum factor by which undistorting may widen or narrow an image."""


def impossible(camera: CameraCalibration) -> str:
    """Return the reason why no real camera can have this calibration; empty if it is plausible."""
    lens = (camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion)
    if not np.isfinite([*lens, *camera.translation, *chain.from_iterable(camera.rotation)]).all():
        return "it has numbers that are not finite"
    if min(camera.width, camera.height) < 1:
        return f"it is for pictures of {camera.width}x{camera.height} pixels"
    return _lens_problem(camera) or _pose_problem(camera) or _distortion_problem(camera)


def _lens_problem(camera: CameraCalibration) -> str:
    shortest, longest = (limit * max(camera.width, camera.height) for limit in FOCAL_LIMITS)
    for focal in (camera.fx, camera.fy):
        if not shortest <= focal <= longest:
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
        distance = float(np.abs(camera.translation).max())
    if not uneven <= MAX_UNEVEN:
        return (
            f"its rotation matrix is not a rotation: unit length or right angles are missed by {uneven:.2g}"
        )
    if np.linalg.det(rotation) < 0:
        return "its rotation is mirrored (determinant -1)"
    return f"it stands {distance:.2g} units away" if distance > MAX_CAMERA_DISTANCE else ""


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
    # The stretch is undefined at the principal point, which may be on the border.
    off_centre = plain > 1e-6
    stretch = float(np.median(np.linalg.norm(rays[off_centre, :2], axis=1) / plain[off_centre]))
    if not 1 / MAX_STRETCH <= stretch <= MAX_STRETCH:
        return f"without its distortion the picture would be {stretch:.2g} times as wide"
    return ""


def calibrated_views(dataset: Dataset, calibration: Calibration) -> dict[str, View]:
    """Return the views of the session's plausibly calibrated cameras, at the size of their images.

    Raises:
        BadInputError: the calibration is of other cameras, or faults leave fewer than two views.
    """
    views, faults = sound_views(dataset, calibration)
    refuse_faults(dataset, views, faults)
    return views


Fault = tuple[str, str]
"""A camera that can be left out, or "" for a fault of the whole rig; and what is wrong."""


def sound_views(dataset: Dataset, calibration: Calibration) -> tuple[dict[str, View], list[Fault]]:
    """Return the cameras whose calibration is plausible for their images, and the faults of the others.

    Raises:
        BadInputError: the calibration is of other cameras.
    """
    if not calibration.cameras.keys() & set(dataset.cameras):
        raise BadInputError(
            f"the calibration is of other cameras ({', '.join(calibration.cameras)}) than {dataset.name}",
            hint="choose another one, or: reconstruct calibrate SESSION --replace",
        )
    views, faults = {}, []
    for name in dataset.cameras:
        if (known := calibration.cameras.get(name)) is None:
            continue
        width, height = dataset.size_on_disk(name)
        if why := impossible(known):
            faults.append((name, f"the calibration of camera {name} cannot be right: {why}"))
        elif abs(known.width / known.height - width / height) > 0.01 * width / height:
            sizes = f"{known.width}x{known.height}, but its images are {width}x{height}"
            faults.append((name, f"camera {name} is calibrated for {sizes}"))
        else:
            views[name] = View.from_calibration(known, *dataset.size(name))
    misplaced = _misplaced(views, calibration.unit)
    for name, _ in misplaced:
        views.pop(name, None)
    return views, faults + misplaced


def _misplaced(views: Mapping[str, View], unit: str) -> list[Fault]:
    """Return the faults of the poses: cameras that have an earlier camera's pose, and a wrong unit."""
    size = max((float(np.linalg.norm(view.centre)) for view in views.values()), default=0.0)
    faults: list[Fault] = []
    nearest: dict[str, float] = {}
    for (a, first), (b, other) in combinations(views.items(), 2):
        apart = float(np.linalg.norm(first.centre - other.centre))
        if apart <= SAME_FRACTION * size and np.abs(first.rotation - other.rotation).max() <= SAME_FRACTION:
            faults.append((b, f"{a} and {b} have one pose, as if they were one camera"))
        elif apart > 0:
            nearest |= {name: min(nearest.get(name, apart), apart) for name in (a, b)}
    spacing = float(np.median(list(nearest.values()))) if nearest else 1.0
    if unit == "m" and not NEIGHBOURS_M[0] <= spacing <= NEIGHBOURS_M[1]:
        faults.append(("", f"neighbouring cameras stand {spacing:.3g} m apart: its unit is not the metre"))
    return faults


def refuse_faults(dataset: Dataset, views: Container[str], faults: Sequence[Fault]) -> None:
    """Raise BadInputError with all faults, if the whole rig has one or fewer than two cameras are left."""
    left = sum(name in views for name in dataset.cameras)
    if faults and (left < 2 or not all(name for name, _ in faults)):
        heading = f"the calibration of {dataset.name} has {len(faults)} faults: " if len(faults) > 1 else ""
        raise BadInputError(
            heading + "; ".join(text for _, text in faults),
            hint="calibrate the rig again, or correct calibration.json",
        )
