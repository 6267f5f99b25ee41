"""The judge of calibrations: whether real cameras can have one, for all that read or store one."""

from collections.abc import Mapping
from itertools import chain, combinations

import numpy as np

from capture_app.common.errors import BadInputError
from capture_app.session.format.calibration import TERMS, CameraCalibration
from capture_app.session.format.lens import centre_of, lens_of, rotation_of

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
MIN_KNOWN = 1 / 3
"""Minimum fraction of the pixels in which a lens is one-to-one, if it is unknown where it was measured."""
MAX_STRETCH = 8.0
"""Maximum factor by which undistorting may widen or narrow an image."""
SAME_FRACTION = 1e-6
"""Relative difference below which poses are equal; positions relative to the rig's extent from its origin."""
NEIGHBOURS_M = 5e-4, 150.0
"""Minimum and maximum distance between neighbouring cameras, metres."""
_GRID = 16
_AGAIN = "export the calibration again with its program, or make one: reconstruct calibrate SESSION"


def check_lens(where: str, camera: CameraCalibration) -> None:
    """Raise BadInputError, its message beginning with `where`, for a calibration that no camera can have."""
    if why := camera_fault(camera):
        raise BadInputError(f"{where} cannot be right: {why}", hint=_AGAIN)


def camera_fault(camera: CameraCalibration) -> str:
    """Return the reason why no real camera can have this calibration; empty if it is plausible."""
    lens = (camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion)
    if not np.isfinite([*lens, *camera.translation, *chain.from_iterable(camera.rotation)]).all():
        return "it has numbers that are not finite"
    if min(camera.width, camera.height) < 1:
        return f"it is for pictures of {camera.width}x{camera.height} pixels"
    return _lens_fault(camera) or _pose_fault(camera) or _distortion_fault(camera)


def _lens_fault(camera: CameraCalibration) -> str:
    shortest, longest = (limit * max(camera.width, camera.height) for limit in FOCAL_LIMITS)
    for focal in (camera.fx, camera.fy):
        if not shortest <= focal <= longest:
            return f"a focal length of {focal:g} px for pictures of {camera.width}x{camera.height}"
    if not 1 / MAX_ASPECT <= camera.fx / camera.fy <= MAX_ASPECT:
        return f"focal lengths of {camera.fx:g} px across and {camera.fy:g} px down"
    if max(abs(camera.cx / camera.width - 0.5), abs(camera.cy / camera.height - 0.5)) > MAX_CENTRE:
        return f"its principal point is ({camera.cx:g}, {camera.cy:g}), far outside the picture"
    return ""


def _pose_fault(camera: CameraCalibration) -> str:
    rotation = np.array(camera.rotation)
    with np.errstate(over="ignore", invalid="ignore"):
        uneven = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
        distance = float(np.abs(camera.translation).max())
    if not uneven <= MAX_UNEVEN:
        return f"its rotation matrix is not orthonormal: lengths or right angles are missed by {uneven:.2g}"
    if np.linalg.det(rotation) < 0:
        return "its rotation is mirrored: the axes are left-handed"
    return f"it stands {distance:.2g} units away" if distance > MAX_CAMERA_DISTANCE else ""


def _distortion_fault(camera: CameraCalibration) -> str:
    terms = TERMS[camera.is_fisheye]
    if any(camera.distortion[len(terms) :]):
        return f"it has {len(camera.distortion)} distortion coefficients; {', '.join(terms)} are understood"
    lens, sides = lens_of(camera), (camera.width, camera.height)
    across, down = np.meshgrid(*(np.linspace(0, side - 1, _GRID) for side in sides))
    pixels = np.column_stack([across.ravel(), down.ravel()])
    with np.errstate(all="ignore"):
        rays = lens.rays(pixels)
        known = lens.known(pixels)
    if isinstance(camera.seen_deg, float) and camera.seen_deg > lens.limit_deg:
        return (
            f"its distortion folds the picture {lens.limit_deg:.1f} degrees off the axis, and points "
            f"{camera.seen_deg:.1f} degrees off are said to fit it"
        )
    if known.mean() < (0.1 if isinstance(camera.seen_deg, float) else MIN_KNOWN):
        return f"its distortion folds the picture: only {100 * known.mean():.0f} % of the pixels have a ray"
    plain = np.hypot(*((pixels - lens.matrix[:2, 2]) / lens.matrix[[0, 1], [0, 1]]).T)
    outer = known & (plain > max(1e-6, 0.7 * plain[known].max()))
    stretch = float(np.median(np.hypot(*rays[outer].T) / plain[outer]))
    if not camera.is_fisheye and not 1 / MAX_STRETCH <= stretch <= MAX_STRETCH:
        return f"without its distortion the picture would be {stretch:.2g} times as wide"
    return ""


Fault = tuple[str, str]
"""A camera that can be left out, or "" for a fault of the whole rig; and what is wrong."""


def rig_faults(cameras: Mapping[str, CameraCalibration], unit: str) -> list[Fault]:
    """Return the faults of the poses: cameras that have an earlier camera's pose, and a wrong unit."""
    centres = {name: centre_of(camera) for name, camera in cameras.items()}
    size = max((float(np.linalg.norm(centre)) for centre in centres.values()), default=0.0)
    faults: list[Fault] = []
    nearest: dict[str, float] = {}
    for a, b in combinations(cameras, 2):
        apart = float(np.linalg.norm(centres[a] - centres[b]))
        turned = np.abs(rotation_of(cameras[a]) - rotation_of(cameras[b])).max()
        if apart <= SAME_FRACTION * size and turned <= SAME_FRACTION:
            faults.append((b, f"{a} and {b} have one pose, as if they were one camera"))
        elif apart > 0:
            nearest |= {name: min(nearest.get(name, apart), apart) for name in (a, b)}
    spacing = float(np.median(list(nearest.values()))) if nearest else 1.0
    if unit == "m" and not NEIGHBOURS_M[0] <= spacing <= NEIGHBOURS_M[1]:
        apart_m = f"{float(f'{spacing:.3g}'):g}"
        faults.append(("", f"neighbouring cameras stand {apart_m} m apart: its unit is not the metre"))
    return faults
