"""Points that do not move, found again between cameras: what calibration and registration rest on."""

from dataclasses import dataclass

import cv2
import numpy as np

from reconstruction.common.geometry import Array

MAX_SIDE_PX = 1280
"""Larger images are made smaller for finding points."""
MAX_POINTS = 2500


@dataclass(frozen=True)
class Features:
    """Points of one image: positions (n, 2) px in the full image, descriptors (n, 128)."""

    positions: Array
    descriptors: Array


def size_above_features(width: int, height: int) -> float:
    """How many times larger a picture is than the one that its points are found in; 1 for small ones."""
    return max(1.0, max(width, height) / MAX_SIDE_PX)


def detect_features(image: Array, movers: Array) -> Features:
    """SIFT points of a grey image (uint8) outside its movers (bool)."""
    scale = min(1.0, MAX_SIDE_PX / max(image.shape))
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else image
    allowed = cv2.resize(
        (~movers).astype(np.uint8) * 255, (small.shape[1], small.shape[0]), interpolation=cv2.INTER_NEAREST
    )
    sift = cv2.SIFT.create(nfeatures=MAX_POINTS, contrastThreshold=0.02)
    keypoints, descriptors = sift.detectAndCompute(small, allowed)
    if descriptors is None:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    positions = np.array([(point.pt[0] + 0.5, point.pt[1] + 0.5) for point in keypoints]) / scale - 0.5
    return Features(positions, np.asarray(descriptors, np.float32))


def match_features(a: Features, b: Features, ratio: float = 0.75) -> tuple[Array, Array]:
    """Positions (n, 2) of points that are each other's best match, in a and in b."""
    of_a, of_b = match_descriptors(a.descriptors, b.descriptors, ratio)
    return a.positions[of_a], b.positions[of_b]


def match_descriptors(a: Array, b: Array, ratio: float) -> tuple[Array, Array]:
    """Indices (n,) of descriptors that are each other's best match, by Lowe's ratio test."""
    if len(a) < 2 or len(b) < 2:
        return np.zeros(0, int), np.zeros(0, int)
    distance = (a**2).sum(1)[:, None] + (b**2).sum(1)[None, :] - 2 * (a @ b.T)
    best = distance.argmin(1)
    rows = np.arange(len(best))
    mutual = distance.argmin(0)[best] == rows
    first = distance[rows, best].copy()
    distance[rows, best] = np.inf
    keep = mutual & (first < ratio**2 * distance.min(1))
    return rows[keep], best[keep]


MIN_MATCHES = 25
GRID = (8, 6)
CELLS = GRID[0] * GRID[1]
"""Cells across, down and in all of the grid that shows over how much of a picture features are spread."""


def grid_cells(at: Array, width: int, height: int) -> set[tuple[int, int]]:
    """The cells of `GRID` that hold pixels (n, 2) of a picture of this size."""
    last = GRID[0] - 1, GRID[1] - 1
    cells = np.floor(at / (width, height) * GRID).clip(0, last).astype(int)
    return {(int(x), int(y)) for x, y in cells}
