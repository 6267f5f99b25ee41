"""Epipolar geometry of two views, and the effect of calibration errors on it."""

from dataclasses import replace

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View, epipolar_errors_px
from reconstruction.scene.calibration.consistency import consistent_matches

ODDS_PX = (1.0, 0.5, 0.3, 0.15)
"""Standard deviations of a calibration's smooth image errors, px: terms of degree 0, 1, 2 and 3 in the
position in the image."""
TERMS = 12
"""Number of terms: ten of `ODDS_PX`, and two of the direction."""
CORRECTIONS = np.array([0.02] * 3 + [0.05] * 2 + [0.02, 0.01, 0.01, 0.05] * 2)
"""Standard deviations of a wrong calibration's errors: three angles and two directions of the baseline (rad);
for each camera the logarithm of the focal length, the principal point (image widths), and k1 of the lens."""
OTHER_FOCALS = ((0.7, 0.7), (1.4, 1.4), (0.87, 1.15), (1.15, 0.87))
"""Factors of both focal lengths by which a guess from still pictures may be off: COLMAP's first guess of 1.2
image widths was 37 % off, within which the points of two cameras hold none."""
MAX_CORRECTION = 10.0
"""Maximum correction, in those standard deviations; a larger one is another optimum or another lens model."""
CORRECTED_PX = 0.5
"""Maximum median epipolar error that a correction may leave."""


def geometry_terms(a: View, b: View, at_a: Array, at_b: Array) -> Array:
    """Return what one standard deviation of each calibration error adds to `epipolar_errors_px`, (n, TERMS).

    Errors of rotation, lens and distortion shift image points smoothly over the image, at any depth. An error
    of the direction between the cameras shifts them by depth, as a delay does with a moving camera.
    """
    x, y = (2 * at_a[:, i] / size - 1 for i, size in enumerate((a.width, a.height)))
    smooth = [
        odds * x ** (degree - down) * y**down
        for degree, odds in enumerate(ODDS_PX)
        for down in range(degree + 1)
    ]
    apart = b.centre - a.centre
    distance = float(np.linalg.norm(apart))
    now = epipolar_errors_px(a, b, at_a, at_b)
    # The direction from one camera to the other is known to 3 mrad.
    steps = distance * 3e-3 * np.linalg.svd(apart[None] / distance)[2][1:]
    moved = (replace(b, translation=b.translation - b.rotation @ step) for step in steps)
    return np.column_stack([*smooth, *(epipolar_errors_px(a, view, at_a, at_b) - now for view in moved)])


def places(geometry: Array) -> Array:
    """Return the image positions (n, 2) that belong to the terms, from -1 to 1 across and down."""
    return np.asarray(geometry[:, 1:3] / ODDS_PX[1])


Correction = tuple[tuple[View, View], float, float]
"""Views with a corrected calibration, and the second camera's delay with its standard deviation, ms."""


def correct_views(
    views: tuple[View, View],
    at_a: Array,
    at_b: Array,
    speeds: Array | None = None,
    period_ms: float = 1.0,
    errors_of: Array = CORRECTIONS,
) -> Correction | None:
    """Correct a calibration so that matches (n, 2) px fit it; None if no correction of plausible size does.

    The matches are static, or move at `speeds` (n, 2) px/ms in the second view: its delay is then fitted
    together with the calibration.

    Gauss-Newton with Cauchy weights and a zero-mean prior of `errors_of` and one frame period: errors that
    the matches do not determine stay uncorrected.
    """
    sds, steps_px = np.append(errors_of, 1.0), np.zeros_like(at_b)
    if speeds is not None:
        # At constant velocity, the baseline's directions act as a delay.
        sds[3:5], steps_px = 0.3, speeds * period_ms
    found, changes = np.zeros(len(sds)), 1e-3 * np.eye(len(sds))

    def errors_px(values: Array) -> Array:
        return epipolar_errors_px(
            *_corrected(views, values * sds), at_a[chosen], at_b[chosen] - values[-1] * steps_px[chosen]
        )

    for _ in range(2):
        good = consistent_matches(_corrected(views, found * sds), at_a, at_b - found[-1] * steps_px)
        if good is None:
            return None
        chosen = np.random.default_rng(0).permutation(np.flatnonzero(good))[:500]
        for _ in range(8):
            errors = errors_px(found)
            beside = np.column_stack([errors_px(found + change) for change in changes])
            slopes = (beside - errors[:, None]) / changes[0, 0]
            sd_px = max(0.2, 1.4826 * float(np.median(np.abs(errors))))
            weights = 1 / sd_px**2 / (1 + (errors / (2 * sd_px)) ** 2)
            normal = slopes.T @ (weights[:, None] * slopes) + np.eye(len(found))
            found = found - np.linalg.solve(normal, slopes.T @ (weights * errors) + found)
            if not np.abs(found).max() < 2 * MAX_CORRECTION:
                return None
    if np.abs(found).max() >= MAX_CORRECTION or np.median(np.abs(errors_px(found))) >= CORRECTED_PX:
        return None
    return (
        _corrected(views, found * sds),
        float(found[-1]) * period_ms,
        float(np.sqrt(np.linalg.inv(normal)[-1, -1])) * period_ms,
    )


def other_calibrations(views: tuple[View, View], at_a: Array, at_b: Array) -> list[tuple[View, View]]:
    """Return calibrations of `OTHER_FOCALS` that fit static matches (n, 2) px, each with its own pose."""
    scaled = (
        tuple(view.magnified(factor) for view, factor in zip(views, factors, strict=True))
        for factors in OTHER_FOCALS
    )
    # With known lenses and poses that are found with other ones.
    corrected = (
        correct_views((a, b), at_a, at_b, errors_of=np.array([0.05] * 3 + [0.1] * 2 + [1e-9] * 8))
        for a, b in scaled
    )
    return [correction[0] for correction in corrected if correction is not None]


def _corrected(views: tuple[View, View], errors: Array) -> tuple[View, View]:
    """Return the views without these errors, in the order of `CORRECTIONS`."""
    a, b = views
    angles, aside, *lenses = np.split(errors[: len(CORRECTIONS)], [3, 5, 9])
    apart = b.centre - a.centre
    distance = float(np.linalg.norm(apart))
    towards = apart + distance * aside @ np.linalg.svd(apart[None])[2][1:]
    rotation = cv2.Rodrigues(angles)[0] @ b.rotation
    centre = a.centre + distance * towards / np.linalg.norm(towards)
    b = replace(b, rotation=rotation, translation=-rotation @ centre)
    return _with_lens(a, lenses[0]), _with_lens(b, lenses[1])


def _with_lens(view: View, errors: Array) -> View:
    matrix, distortion = view.matrix.copy(), view.distortion.copy()
    matrix[[0, 1], [0, 1]] *= np.exp(errors[0])
    matrix[:2, 2] += view.width * errors[1:3]
    distortion[0] += errors[3]
    return replace(view, matrix=matrix, distortion=distortion)
