"""Confidence of depth: the probability of each pixel's depth to be within 2 % of the true one.

It is the lower of two. One is how often pixels with such votes of the other views and such surroundings are
right, by a logistic regression (`WEIGHTS`). The other is how well the calibration can measure 2 % of depth
there.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import CalibratedImage, SourceView
from reconstruction.depth.geometric_consistency import MAX_ANGLE_DEG
from reconstruction.depth.plane_sweep import Surface
from reconstruction.depth.sweep_kernels import Agreement, compare_surfaces
from reconstruction.method.truth import DEPTH_TOLERANCE
from reconstruction.methods.multiview.blank_walls import EVIDENT_COST
from reconstruction.methods.multiview.edge_sharpening import depth_edges
from reconstruction.methods.multiview.sweep_matcher import ViewDepth, voting_views
from reconstruction.scene.calibration.consistency import INACCURATE_PX

Terms = dict[str, Array | float]
"""What is known of the depths of a view, by the names of `WEIGHTS`; arrays are float32 height x width."""
CLOSE = 0.005
"""Relative difference of depth within which a view agrees closely."""
WEIGHTS = {
    "constant": -3.95,
    "agreeing": 1.3,
    "close": 0.93,
    "beside": -1.61,
    "in_front": -1.17,
    "holes": -1.83,
    "uneven": -0.78,
    "all_agreeing": 3.74,
    "all_uneven": -7.63,
    "all_carried": -1.15,
    "all_detailed": 2.64,
}
"""Log odds of a right depth by each term: a constant; the fractions of the views able to see the surface that
agree, and that agree closely; the nearness of an edge, 1 at it; depth in front of another surface, as windows
widen objects; the fraction of the neighbourhood without depth; and depth that differs from the median of its
neighbours. The last four are of the whole map, as faults come together: the fraction of all votes that agree;
its mean unevenness; the fraction of its depth that smoothness carried over blank areas, where views agree
without evidence; and the fraction where the image's detail shows 2 % of depth. All terms are 0 to 1.

Fitted by `make bench NAME=confidence BENCH=--fit` on 2026-11-30, to 144 rooms of three to eight cameras."""
ASSUMED_RESIDUAL_PX = 0.5
"""Misfit of a calibration that could not be checked."""
DETAIL_PX = 15
"""Side of the neighbourhood whose detail counts, px: depth is smoothed about that far."""
POINTS_PX, BLANK_POINTS_PX = 0.08, 0.21
"""Misfit of a perfect calibration, as points are found, and what it has more in an entirely blank image.

A line through 134 drawn rooms, whose misfits are 0.03 to 0.34; it leaves a standard deviation of 0.05."""
POSE_FACTOR, PAIR_POSE_FACTOR = 0.75, 2.1
"""Standard deviation of a camera's error along epipolar lines relative to the rest of its misfit: the first
fits 22 draws of a plain room's three and five cameras, turned by 0.5 px; the other is that of two cameras,
whose points adapt to it."""
UNSEEN_PX, PAIR_UNSEEN_PX = 0.05, 0.32
"""Standard deviation of errors that no point shows, such as turns in proportion to the baselines; and that of
two cameras, where a turn sideways of one shifts all disparities. Those of matches are in the votes."""
ROTATION_PX = 1.0
"""Turn sideways that two cameras do not show, up to which the range of their confidence goes."""
ASKEW = 1.5
"""Standard deviation of matches, px, by the square of the misfit: windows beside epipolar lines differ."""
FREEDOM = 0.5
"""Degrees of freedom of the misfit, for each camera after the first."""
ODDS = {"checked": (0.32, 3.0), "not checked": (0.28, 11.0), "misfit": (0.0, 7.8)}
"""Factors of the odds of a right depth, from those said to those of 95 % of rooms: by a calibration that fits
points at rest, that could not be checked, and that misfits by `INACCURATE_PX` or more.

Fitted by `make bench NAME=confidence BENCH=--fit-odds` on 2026-11-30, to 239 rooms, of which 28 had their
cameras turned by 0.5 px: of those that misfit, some had nothing right."""


class DepthSupport(NamedTuple):
    """What is known of the depths of a view; the arrays are float32 height x width."""

    evidence: Array
    """Log odds of a right depth if the calibration is exact: the sum of all terms by `WEIGHTS`."""
    worth_px: Array
    """Motion in another view, px, by 2 % of the depth: the largest of all views."""
    cameras: int = 2
    """Number of cameras of the rig."""
    rotation_gain: Array | float = math.sqrt(2)
    """Error by turns of all cameras by 1 px, px of `worth_px`; of two cameras by default."""
    points_px: float = POINTS_PX
    """Misfit that this image's points have to a perfect calibration."""

    def confidence(self, residual_px: float | None, scale_error: float = 0.0) -> Array:
        """Return the probability that depth is right, 0 to 1, by the calibration's misfit (px) and scale."""
        right = 1 / (1 + np.exp(-self.evidence))
        # Errors of the calibration also lower the votes: a product would count them twice.
        return np.minimum(right, self.measurable(residual_px, scale_error)).astype(np.float32)

    def confidence_if_turned(
        self, residual_px: float | None, scale_error: float = 0.0
    ) -> tuple[Array, Array]:
        """Return the confidence if a camera is turned sideways by `ROTATION_PX`, unseen by two, and if not.

        The latter is what it would be if a third camera, opposite to the second one, showed such turns.
        """
        exact = self._replace(cameras=3, rotation_gain=math.sqrt(0.5)).confidence(
            residual_px or self.points_px, scale_error
        )
        return exact * (self.worth_px > ROTATION_PX), exact

    def expected_range(
        self, known: Array, residual_px: float | None, scale_error: float = 0.0
    ) -> tuple[float, float]:
        """Return the 95 % interval of the fraction of all pixels that have a right depth, 0 to 1.

        `known` is where there is depth (bool). All pixels of a scene share what no term shows: it multiplies
        the odds of their mean confidence. Of two cameras, the range is also that of `confidence_if_turned`.
        """
        exact = self.confidence(residual_px, scale_error)
        ends = self.confidence_if_turned(residual_px, scale_error) if self.cameras == 2 else (exact, exact)
        coverage = max(float(known.mean()), 1e-9)
        means = (float((end * known).mean()) / coverage for end in ends)
        odds = ODDS[how_checked(residual_px)]
        low, high = (coverage * p * k / (1 - p + p * k) for p, k in zip(means, odds, strict=True))
        return round(low, 4), round(high, 4)

    def measurable(self, residual_px: float | None, scale_error: float = 0.0) -> Array:
        """Return the probability that a right match gives a right depth: that of an error within `worth_px`.

        `residual_px` is that of points at rest to the calibration, px; None = unknown. `scale_error` is the
        relative standard deviation of its scale, and so of all depths.

        Points show errors across their epipolar lines only, depth suffers from those along them, and few
        cameras have few errors: the misfit tells the size of the others with an uncertainty that Student's t
        has. The constants were fitted to rigs whose cameras were turned by up to 2 px.
        """
        residual_px = ASSUMED_RESIDUAL_PX if residual_px is None else residual_px
        factor, unseen_px = (
            (PAIR_POSE_FACTOR, PAIR_UNSEEN_PX) if self.cameras == 2 else (POSE_FACTOR, UNSEEN_PX)
        )
        excess = max(residual_px**2 - self.points_px**2, 0.0)
        pose_px = factor * self.rotation_gain * math.sqrt(excess)
        scale_px = self.worth_px * (scale_error / DEPTH_TOLERANCE)
        sigma_px = np.hypot(np.hypot(scale_px, pose_px), math.hypot(ASKEW * excess, unseen_px))
        # The degrees of freedom of a sum of known and estimated variances (Welch and Satterthwaite).
        freedom = FREEDOM * (self.cameras - 1) * (sigma_px / np.maximum(pose_px, 1e-3)) ** 4
        # Student's t as a normal deviate (Wallace 1959).
        squared = freedom * np.log1p((self.worth_px / sigma_px) ** 2 / freedom)
        deviate = (8 * freedom + 1) / (8 * freedom + 3) * np.sqrt(squared)
        sigmas = np.linspace(0, 5, 501)
        within = [math.erf(float(x) / math.sqrt(2)) for x in sigmas]
        return np.asarray(np.interp(deviate, sigmas, within))


def how_checked(residual_px: float | None) -> str:
    """Return which of `ODDS` a calibration has, by the misfit of points at rest, px."""
    return "not checked" if residual_px is None else "misfit" if residual_px >= INACCURATE_PX else "checked"


def measure_support(
    images: Mapping[str, CalibratedImage],
    sources: Mapping[str, Sequence[str]],
    depths: Mapping[str, ViewDepth],
) -> Iterator[tuple[str, DepthSupport]]:
    """Yield each camera with what supports its depth, from the surfaces of all cameras.

    `sources` are the cameras that each was matched with. COLMAP's maps, without a surface, are left out.
    """
    for name, terms, worth_px, gain in measure_terms(images, sources, depths):
        evidence = sum(weight * terms[term] for term, weight in WEIGHTS.items())
        yield (
            name,
            DepthSupport(
                np.asarray(evidence),
                worth_px,
                len(images),
                gain,
                points_px=POINTS_PX + BLANK_POINTS_PX * float(images[name].flat.mean()),
            ),
        )


def measure_terms(
    images: Mapping[str, CalibratedImage],
    sources: Mapping[str, Sequence[str]],
    depths: Mapping[str, ViewDepth],
) -> Iterator[tuple[str, Terms, Array, Array]]:
    """Yield each camera with the terms of its depth, and its `worth_px` and `rotation_gain`."""
    surfaces = {name: view.surface for name, view in depths.items() if view.surface is not None}
    for name, surface in surfaces.items():
        others = voting_views(name, sources, surfaces)
        voters = [(SourceView(images[name], images[other]), surfaces[other]) for other in others]
        known = depths[name].depth > 0
        terms, worth_px, squares, gain = _votes(surface, voters, known)
        terms |= _surroundings(surface, known) | _evidence(images[name], surface, squares, known)
        yield name, terms, worth_px, gain


def _votes(
    surface: Surface, voters: Sequence[tuple[SourceView, Surface]], known: Array
) -> tuple[Terms, Array, Array, Array]:
    """Return the terms by other views, `worth_px`, the sum of squared motions (px), and `rotation_gain`.

    The gain is of the least squares of all views' motions: a turn of a view moves its own match, one of this
    camera moves all of them alike, so that only motions to opposite sides make up for it.
    """
    level = surface.inverse_depth
    agreeing, close, able, worth, squares = (np.zeros(level.shape, np.float32) for _ in range(5))
    motions = np.zeros((2, *level.shape), np.float32)
    cosine = float(np.cos(np.radians(MAX_ANGLE_DEG)))
    for view, other in voters:
        same, sees = compare_surfaces(
            level, view, other.inverse_depth, Agreement(DEPTH_TOLERANCE, DEPTH_TOLERANCE, 0.0, cosine)
        )
        agreeing += same
        able += sees
        close += compare_surfaces(level, view, other.inverse_depth, Agreement(CLOSE, CLOSE, 0.0, cosine))[0]
        moved = _moved_px(view, level)
        motions += moved
        squares += (moved**2).sum(0)
        np.maximum(worth, np.hypot(*moved), out=worth)
    gain = worth * np.sqrt(squares + (motions**2).sum(0)) / np.maximum(squares, 1e-12)
    # As if a quarter of a view disagreed: one view is less evidence than several.
    able_or_more = able + 0.25
    terms: Terms = {
        "agreeing": agreeing / able_or_more,
        "close": close / able_or_more,
        "all_agreeing": float(agreeing[known].sum()) / max(float(able[known].sum()), 1.0),
    }
    return terms, worth, squares, gain


def _surroundings(surface: Surface, known: Array) -> Terms:
    """Return the terms by the surroundings in the view's own depth map, which is `known` there."""
    level, around = np.maximum(surface.inverse_depth, 1e-12), np.ones((15, 15))
    step = np.log(level / cv2.erode(level, around))
    # A difference of 2 % from the median counts in full, and a step of 10 %.
    uneven = np.minimum(np.abs(level / cv2.medianBlur(level, 5) - 1) / 0.02, 1)
    return {
        "constant": 1.0,
        "beside": 1 / (1 + _distance_to_edges(level)),
        "in_front": np.minimum(step / 0.1, 1),
        "holes": 1 - cv2.blur(known.astype(np.float32), around.shape),
        "uneven": uneven,
        "all_uneven": float(uneven[known].sum()) / max(int(known.sum()), 1),
    }


def _evidence(image: CalibratedImage, surface: Surface, squares: Array, known: Array) -> Terms:
    """Return the terms by what the image shows; `squares` are of the motions by 2 % of depth, px squared."""
    variance = image.noise / 9  # that of a pixel
    down, right = np.gradient(image.grey)
    detail = cv2.boxFilter(right**2 + down**2 - variance, -1, (DETAIL_PX, DETAIL_PX), normalize=False)
    # Squared signal to noise of 2 % of depth, if gradients have all directions.
    shown = np.maximum(detail, 0) * squares / (4 * variance)
    count = max(int(known.sum()), 1)
    return {
        "all_carried": int((image.flat & known & (surface.cost > np.float32(EVIDENT_COST))).sum()) / count,
        "all_detailed": float((shown / (shown + 1))[known].sum()) / count,
    }


def _moved_px(view: SourceView, level: Array) -> Array:
    """Return the motion in a source (2, ...), px, by `DEPTH_TOLERANCE` of the depth; 0 behind the source."""
    (x, y, _), (moved_x, moved_y, _) = (view.project(level * np.float32(f)) for f in (1, 1 + DEPTH_TOLERANCE))
    return np.asarray(np.nan_to_num([moved_x - x, moved_y - y]))


def _distance_to_edges(level: Array) -> Array:
    """Return the distance, px, of each pixel from the nearest edge of depth; at most 20."""
    distance = cv2.distanceTransform((~depth_edges(level)).astype(np.uint8), cv2.DIST_L2, 5)
    return np.asarray(np.minimum(distance, 20))
