"""Quality of a calibration, from the reprojection errors of points that two cameras share."""

from collections.abc import Mapping

import numpy as np
from msgspec import Struct

from capture_app.common.errors import BadInputError
from reconstruction.calibration.consistency import reprojection_errors, triangulate
from reconstruction.common.geometry import Array, View, angles_deg
from reconstruction.pairs import CELLS, MIN_MATCHES, grid_cells

SharedPoints = Mapping[tuple[str, str], tuple[Array, Array]]
"""For pairs of cameras, pixels (n, 2) of the same points in the first and in the second."""
INLIER_PX = 4.0
"""Maximum reprojection error of an inlier; beyond it the match or the calibration is wrong."""
MIN_POINTS = 50
MIN_INLIER_FRACTION = 0.4
MAX_REPROJECTION_PX = 2.0
MIN_ANGLE_DEG = 0.3


class CalibrationQuality(Struct, frozen=True, kw_only=True):
    """Quality from points that camera pairs share; an inlier's reprojection error is below `INLIER_PX`."""

    points: int
    inlier_share: float
    reprojection_error_px: float | None
    """Median over the inliers of the larger of a point's two errors."""
    triangulation_angle_deg: float | None
    """Median angle between an inlier's two rays."""
    coverage: dict[str, float]
    """By camera, the fraction of an 8 x 6 grid's cells that contain an inlier."""


def judge_calibration(views: Mapping[str, View], shared: SharedPoints) -> CalibrationQuality:
    """Judge a calibration by the reprojection errors of triangulated points (Hartley and Sturm, linear)."""
    errors, angles, fits = [], [], []
    cells: dict[str, set[tuple[int, int]]] = {name: set() for name in views}
    for (a, b), (at_a, at_b) in shared.items():
        if a not in views or b not in views or len(at_a) < MIN_MATCHES:
            continue
        error, angle = _triangulate(views[a], views[b], at_a, at_b)
        good = error < INLIER_PX
        errors.append(error[good])
        angles.append(angle[good])
        fits.append(good)
        for name, at in ((a, at_a), (b, at_b)):
            cells[name] |= grid_cells(at[good], views[name].width, views[name].height)
    every = np.concatenate(fits) if fits else np.zeros(0, bool)
    return CalibrationQuality(
        points=len(every),
        inlier_share=float(every.mean()) if len(every) else 0.0,
        reprojection_error_px=float(np.median(np.concatenate(errors))) if every.any() else None,
        triangulation_angle_deg=float(np.median(np.concatenate(angles))) if every.any() else None,
        coverage={name: len(found) / CELLS for name, found in cells.items()},
    )


def refuse_bad_calibration(quality: CalibrationQuality, cameras: int) -> None:
    """Raise BadInputError with the reason if a rig's calibration is not fit for measurements."""
    error, angle = quality.reprojection_error_px, quality.triangulation_angle_deg
    share = f"{100 * quality.inlier_share:.0f} %"
    unjudged = why = ""
    if 2 * len(quality.coverage) < cameras:
        why = f"it covers only {len(quality.coverage)} of {cameras} cameras"
    elif error is None or angle is None:
        unjudged = "no two of its cameras see enough of the same points"
    elif quality.points < MIN_POINTS:
        unjudged = f"its cameras share only {quality.points} points; {MIN_POINTS} are needed"
    elif quality.inlier_share < MIN_INLIER_FRACTION:
        why = f"only {share} of the shared points have a reprojection error below {INLIER_PX:g} px"
    elif error > MAX_REPROJECTION_PX:
        why = f"the median reprojection error is {error:.1f} px, above {MAX_REPROJECTION_PX:g} px"
    elif angle < MIN_ANGLE_DEG:
        why = f"the median triangulation angle is {angle:.2f} degrees, too small to measure depth"
    if unjudged:
        raise BadInputError(
            f"this calibration cannot be judged: {unjudged}",
            hint="record a board, held where neighbouring cameras both see it",
        )
    if why:
        raise BadInputError(
            f"this calibration is not good enough: {why}",
            hint="record a board from several places, in front of this rig, and calibrate again",
        )


def _triangulate(a: View, b: View, at_a: Array, at_b: Array) -> tuple[Array, Array]:
    """Return each point's larger reprojection error, px, and the angle between its rays, degrees."""
    points = triangulate((a, b), np.stack((at_a, at_b)))
    error = np.maximum(reprojection_errors(a, points, at_a), reprojection_errors(b, points, at_b))
    return error, angles_deg(a.rays(at_a) @ a.rotation, b.rays(at_b) @ b.rotation)
