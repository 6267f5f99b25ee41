"""What neighbours have confirmed, proposed to a view where it found nothing that they confirm."""

from collections.abc import Iterable

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import SourceView


def propose_inverse_depth(others: Iterable[tuple[SourceView, Array]], shape: tuple[int, int]) -> Array:
    """Inverse depth (`shape`) of the nearest surface that other views' depths put here; 0 = none.

    The source views are from each other view to this one.
    """
    nearest = np.zeros(shape, np.float32)
    for to_this, depth in others:
        inverse = np.where(depth > 0, 1 / np.maximum(depth, 1e-12), 0).astype(np.float32)
        x, y, z = to_this.project(inverse)
        there = (depth > 0) & (z > 1e-6) & np.isfinite(x) & np.isfinite(y)
        column, row = np.rint(x[there]).astype(np.int64), np.rint(y[there]).astype(np.int64)
        inside = (column >= 0) & (column < shape[1]) & (row >= 0) & (row < shape[0])
        at = row[inside] * shape[1] + column[inside]
        np.maximum.at(nearest.reshape(-1), at, (inverse[there] / z[there])[inside])
    return _close_gaps(nearest)


def _close_gaps(inverse_depth: Array) -> Array:
    """Gaps of a pixel closed, and what is seen between the points of something nearer taken away."""
    kernel = np.ones((3, 3), np.uint8)
    front = cv2.morphologyEx(inverse_depth, cv2.MORPH_CLOSE, kernel)
    behind = inverse_depth < 0.98 * front
    return np.where(behind, front, inverse_depth).astype(np.float32)
