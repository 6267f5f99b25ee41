"""How good a calibration is: whether points that two cameras share meet in space, and where they are."""

from collections.abc import Mapping

import cv2
import numpy as np
from msgspec import Struct

from capture_app.errors import BadInputError
from reconstruction.calibration.features import FEWEST_MATCHES
from reconstruction.common.geometry import Array, View, other_from_reference

SharedPoints = Mapping[tuple[str, str], tuple[Array, Array]]
"""For pairs of cameras, pixels (n, 2) of the same points in the first and in the second."""
FITTING_PX = 4.0
"""Points that are further from themselves than this were matched wrongly, or the calibration is wrong."""
FEWEST_POINTS = 50
LEAST_FITTING = 0.4
MOST_REPROJECTION_PX = 2.0
LEAST_ANGLE_DEG = 0.3


class CalibrationQuality(Struct, frozen=True, kw_only=True):
    """Judged by points that pairs of cameras share.

    `reprojection_px`: median distance of a point's two pixels from its best place in space, of those within
    4 px; `fitting`: the share that is; `angle_deg`: median angle between the two rays; `coverage`: by camera,
    the share of the cells of an 8 x 6 grid with a fitting point.
    """

    points: int
    fitting: float
    reprojection_px: float | None
    angle_deg: float | None
    coverage: dict[str, float]


def judge_calibration(views: Mapping[str, View], shared: SharedPoints) -> CalibrationQuality:
    """Triangulate every shared point (Hartley and Sturm's linear method) and see how it fits."""
    errors, angles, fits = [], [], []
    cells: dict[str, set[tuple[int, int]]] = {name: set() for name in views}
    for (a, b), (at_a, at_b) in shared.items():
        if a not in views or b not in views or len(at_a) < FEWEST_MATCHES:
            continue
        error, angle = _triangulate(views[a], views[b], at_a, at_b)
        good = error < FITTING_PX
        errors.append(error[good])
        angles.append(angle[good])
        fits.append(good)
        for name, at in ((a, at_a), (b, at_b)):
            where = np.floor(at[good] / (views[name].width, views[name].height) * (8, 6)).astype(int)
            cells[name] |= {(int(x), int(y)) for x, y in where}
    every = np.concatenate(fits) if fits else np.zeros(0, bool)
    return CalibrationQuality(
        points=len(every),
        fitting=float(every.mean()) if len(every) else 0.0,
        reprojection_px=float(np.median(np.concatenate(errors))) if every.any() else None,
        angle_deg=float(np.median(np.concatenate(angles))) if every.any() else None,
        coverage={name: len(found) / 48 for name, found in cells.items()},
    )


def refuse_bad_calibration(quality: CalibrationQuality, cameras: int) -> None:
    """Raise BadInputError with the reason where a rig's calibration is not fit to measure with."""
    why, judged = "", True
    if 2 * len(quality.coverage) < cameras:
        why = f"it places {len(quality.coverage)} of {cameras} cameras only"
    elif quality.reprojection_px is None or quality.angle_deg is None:
        why, judged = "no two of its cameras see enough of the same points", False
    elif quality.points < FEWEST_POINTS:
        why, judged = f"its cameras share {quality.points} points only, and it takes {FEWEST_POINTS}", False
    elif quality.fitting < LEAST_FITTING:
        why = (
            f"only {100 * quality.fitting:.0f} % of the points that two cameras share fit to within "
            f"{FITTING_PX:g} px"
        )
    elif quality.reprojection_px > MOST_REPROJECTION_PX:
        why = f"points miss themselves by {quality.reprojection_px:.1f} px (at most {MOST_REPROJECTION_PX:g})"
    elif quality.angle_deg < LEAST_ANGLE_DEG:
        why = f"the cameras see points under {quality.angle_deg:.2f} degrees, too little to tell depth"
    if why and not judged:
        raise BadInputError(
            f"this calibration cannot be judged: {why}",
            hint="record a board, held where neighbouring cameras both see it",
        )
    if why:
        raise BadInputError(
            f"this calibration is not good enough: {why}",
            hint="were the cameras moved, or is it another rig's? record a board from several places",
        )


def _triangulate(a: View, b: View, at_a: Array, at_b: Array) -> tuple[Array, Array]:
    """For every point the larger of its two reprojection errors, px, and the angle of its rays, degrees."""
    rays_a, rays_b = a.rays(at_a), b.rays(at_b)
    rotation, translation = other_from_reference(a, b)
    first = np.hstack([np.eye(3), np.zeros((3, 1))])
    second = np.hstack([rotation, translation[:, None]])
    found = cv2.triangulatePoints(first, second, rays_a[:, :2].T.copy(), rays_b[:, :2].T.copy())
    far = np.where(np.abs(found[3]) < 1e-12, 1e-12, found[3])
    points = (found[:3] / far).T
    error = np.zeros(len(points))
    for view, turn, move, at in (
        (a, np.eye(3), np.zeros(3), at_a),
        (b, rotation, translation, at_b),
    ):
        there = points @ turn.T + move
        front = there[:, 2] > 1e-9
        safe = np.where(front[:, None], there, (0.0, 0.0, 1.0))
        pixels, _ = cv2.projectPoints(safe, np.zeros(3), np.zeros(3), view.matrix, view.distortion)
        distance = np.linalg.norm(pixels.reshape(-1, 2) - at, axis=1)
        error = np.maximum(error, np.where(front, distance, np.inf))
    turned = rays_a @ rotation.T
    cosine = (turned * rays_b).sum(1) / np.linalg.norm(turned, axis=1) / np.linalg.norm(rays_b, axis=1)
    return error, np.degrees(np.arccos(np.clip(cosine, -1, 1)))
