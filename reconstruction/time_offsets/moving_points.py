"""Points on what moves in one image, and where they are in the images before and after."""

from dataclasses import dataclass

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.common.point_tracking import track_there_and_back
from reconstruction.pairs.features import match_descriptors

MAX_POINTS = 400
MAX_SIDE_PX = 960
"""Where what moves is larger, points are looked for in a smaller picture of it."""
MARGIN_PX = 16
"""Of the picture around what moves, so that points at its edge are described too."""
MAX_DRIFT_PX = 0.5
"""A point followed to the neighbouring image and back must return to within this."""
WINDOW_PX = 15
LEVELS = 4
"""Of the pyramid in which points are followed."""


@dataclass(frozen=True)
class MovingPoints:
    """Points of one image: `at` (n, 2) px, unit descriptors (n, 128), `before` and `after` (n, 2) px.

    The latter are the places in the image before and the one after, NaN where a point was not followed.
    """

    at: Array
    descriptors: Array
    before: Array
    after: Array


def find_moving_points(
    image: Array, movers: Array, before: Array | None, after: Array | None
) -> MovingPoints:
    """SIFT points (RootSIFT) of a grey image (uint8) on its movers (bool), followed by Lucas-Kanade.

    Descriptors are square roots of SIFT's, normalized to sum 1 (Arandjelovic and Zisserman 2012).
    """
    nothing = np.zeros((0, 2))
    if not movers.any():
        return MovingPoints(nothing, np.zeros((0, 128), np.float32), nothing, nothing)
    ys, xs = np.nonzero(movers)
    left, top = max(0, int(xs.min()) - MARGIN_PX), max(0, int(ys.min()) - MARGIN_PX)
    part = np.s_[top : int(ys.max()) + MARGIN_PX, left : int(xs.max()) + MARGIN_PX]
    small, allowed = np.ascontiguousarray(image[part]), np.ascontiguousarray(movers[part]).astype(np.uint8)
    scale = min(1.0, MAX_SIDE_PX / max(small.shape))
    if scale < 1:
        small = cv2.resize(small, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        allowed = cv2.resize(allowed, small.shape[::-1], interpolation=cv2.INTER_NEAREST)
    sift = cv2.SIFT.create(nfeatures=MAX_POINTS, contrastThreshold=0.01)
    keypoints, raw = sift.detectAndCompute(small, allowed)
    if raw is None:
        return MovingPoints(nothing, np.zeros((0, 128), np.float32), nothing, nothing)
    at = (np.array([point.pt for point in keypoints]) + 0.5) / scale - 0.5 + np.array([left, top])
    roots = np.sqrt(raw / np.maximum(raw.sum(1, keepdims=True), 1e-7)).astype(np.float32)
    return MovingPoints(at, roots, _follow(image, before, at), _follow(image, after, at))


def match_moving_points(a: MovingPoints, b: MovingPoints, ratio: float = 0.8) -> tuple[Array, Array]:
    """Indices (n,) into a and b of points that are each other's best match."""
    return match_descriptors(a.descriptors, b.descriptors, ratio)


def _follow(image: Array, other: Array | None, at: Array) -> Array:
    """Where points (n, 2) lie in another image; NaN where they do not return."""
    if other is None:
        return np.full_like(at, np.nan)
    there, drift = track_there_and_back(image, other, at, WINDOW_PX, LEVELS)
    return np.where((drift < MAX_DRIFT_PX)[:, None], there.astype(np.float64), np.nan)
