"""Outlines of small moving objects, tracked by their centres: a ball has hardly any corners to track."""

from dataclasses import dataclass

import cv2
import numpy as np

from reconstruction.common.geometry import Array

MIN_AREA_PX = 20.0
"""Minimum area; smaller objects are noise."""
MAX_FRACTION = 0.02
"""Maximum area, as a fraction of the image; larger objects have corners, and parts that move separately."""
MAX_ASPECT = 2.0
"""Maximum ratio of an object's sides."""
MIN_SOLID = 0.8
"""Minimum fraction of its convex hull that an object fills."""
GROWTH = 1.5
"""Maximum ratio of an object's areas in two successive images."""
MAX_STEP_WIDTHS = 6.0
"""Maximum distance that an object moves between successive images, in object widths."""
MAX_CHANGE, SMALL_STEP_PX = 0.5, 2.0
"""Maximum change of an object's speed, as a fraction, and a step between images that may change wholly."""
SHAPE_ERROR = 0.5
"""Error of an object's centre along an axis, as a fraction of its contour's deviation from an ellipse.

Where an object is as bright as the background, a part of it is missing.
"""


@dataclass(frozen=True)
class Outlines:
    """Centres (n, 2) px and areas (n,) px of the small moving objects in an image.

    `errors_px` (n,) are the standard deviations of the centres.
    """

    at: Array
    area: Array
    errors_px: Array

    def nearest(self, others: "Outlines | None") -> Array:
        """Return each object's place in another image, (n, 2) px; NaN if the match is missing or ambiguous.

        An object matches if it is the only one of similar size nearby.
        """
        if others is None or not len(others.at):
            return np.full_like(self.at, np.nan)
        distances = np.linalg.norm(others.at - self.at[:, None], axis=2)
        near = distances < MAX_STEP_WIDTHS * np.sqrt(self.area)[:, None]
        near &= np.abs(np.log(others.area / self.area[:, None])) < np.log(GROWTH)
        return np.where(near.sum(1, keepdims=True) == 1, others.at[near.argmax(1)], np.nan)


def moves_evenly(at: Array, times_ms: Array) -> Array:
    """Return which objects (n,) were followed through three images, at (3, n, 2) px and (3, n) ms, evenly.

    A part of an object comes and goes, and its neighbour of similar size is another part: a jump to it and
    back is fast, and a fast point shows its time most precisely.
    """
    steps, apart_ms = np.diff(at, axis=0), np.diff(times_ms, axis=0)
    speeds = steps / apart_ms[..., None]
    fastest = np.linalg.norm(speeds, axis=2).max(0)
    changes = np.linalg.norm(speeds[1] - speeds[0], axis=1)
    # Where it is missing in one of the images, nothing contradicts.
    return np.asarray(~(changes > MAX_CHANGE * fastest + SMALL_STEP_PX / np.abs(apart_ms).min(0)))


def find_outlines(image: Array, background: Array, moving: Array) -> Outlines:
    """Find small compact objects in a grey image (uint8) that stand out from the background and move.

    `moving` is the mask (bool) of moving pixels.
    """
    difference = image.astype(np.float32) - background
    difference = np.abs(cv2.GaussianBlur(difference - float(np.median(difference)), (0, 0), 0.7))
    differs = difference > max(12.0, 6 * 1.4826 * float(np.median(difference)))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(differs.astype(np.uint8))
    height, width = image.shape
    # An object must be within the image with this margin.
    edge_px = 2
    largest = sorted(range(1, count), key=lambda k: -int(stats[k, cv2.CC_STAT_AREA]))
    outlines: list[tuple[Array, float, float]] = []
    for k in largest:
        left, top, wide, high, area = (int(value) for value in stats[k])
        whole = min(left, top, width - left - wide, height - top - high) >= edge_px
        compact = max(wide, high) < MAX_ASPECT * min(wide, high)
        if area < MIN_AREA_PX or len(outlines) == 4:
            break
        if area > MAX_FRACTION * image.size or not whole or not compact:
            continue
        part = np.s_[top - edge_px : top + high + edge_px, left - edge_px : left + wide + edge_px]
        mask = labels[part] == k
        solid = mask.sum() > MIN_SOLID * cv2.contourArea(cv2.convexHull(_contour(mask)))
        if solid and (moving[part] & mask).any():
            outlines.append(_measured(difference[part], mask, (left - edge_px, top - edge_px)))
    at, areas, errors_px = (np.array([outline[i] for outline in outlines]) for i in range(3))
    return Outlines(at.reshape(-1, 2), areas, errors_px)


def _contour(mask: Array) -> Array:
    """Return the outer contour (n, 2) px of an object (bool)."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.concatenate(contours)[:, 0]


def _roughness_px(mask: Array) -> float:
    """Return the standard deviation of an object's contour from an ellipse of the same second moments."""
    inside = np.argwhere(mask)[:, ::-1]
    spread, offset = np.cov(inside.T), _contour(mask) - inside.mean(0)
    radii = np.sqrt((offset @ np.linalg.inv(spread) * offset).sum(1)) / 2
    deviation_px = 2 * np.linalg.det(spread) ** 0.25 * radii.std()
    # A perfect ellipse's contour deviates by 0.28 px, as it consists of whole pixels.
    return float(np.sqrt(max(0.0, deviation_px**2 - 0.28**2)))


def _measured(difference: Array, mask: Array, corner: tuple[int, int]) -> tuple[Array, float, float]:
    """Return the centre of an object (bool), its area and the centre's error.

    Border pixels count by their difference from the background.
    """
    mostly = float(np.median(difference[mask]))
    near = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    weights = np.clip(difference / (0.8 * mostly), 0, 1) * near
    ys, xs = np.mgrid[: mask.shape[0], : mask.shape[1]]
    total = float(weights.sum())
    middle = np.array([(weights * xs).sum(), (weights * ys).sum()]) / total + np.array(corner)
    return middle, total, SHAPE_ERROR * _roughness_px(mask)


def similar_objects(a: Outlines, b: Outlines) -> tuple[Array, Array]:
    """Return the indices (n,) in a and b of objects that may be the same: all pairs of similar size."""
    of_a, of_b = np.nonzero(np.abs(np.log(a.area[:, None] / b.area)) < 2 * np.log(GROWTH))
    return of_a, of_b
