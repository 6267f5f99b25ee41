"""A disparity for every pixel: what only one view sees is taken from the surface behind it."""

import cv2
import numpy as np

from reconstruction.common.geometry import Array

STEP = 16
"""Distance over which slopes are measured, px."""
WINDOW = 61
"""Side of the window over which they are averaged, px."""
MAX_CHANGE = 3.0
"""Over one step; a greater one is an edge, not a slope. px."""


def fill_holes(disparity: Array) -> Array:
    """The disparity (float32 height x width, px, NaN = none) with every hole filled; 0 if nothing is known.

    What one view alone sees lies behind what hides it from the other, so a hole continues the farther one
    of the surfaces to its left and right (Hirschmueller 2008), along their slope; then the median around it.
    """
    known = np.isfinite(disparity)
    rows = np.flatnonzero(known.any(axis=1))
    if not rows.size:
        return np.zeros_like(disparity)
    width = disparity.shape[1]
    columns = np.arange(width, dtype=np.int32)
    left = np.maximum.accumulate(np.where(known, columns, -1), axis=1)
    right = np.minimum.accumulate(np.where(known, columns, width)[:, ::-1], axis=1)[:, ::-1]
    slope = _mean_slope(disparity)
    nearest, continued = [], []
    for place, there in ((left, left >= 0), (right, right < width)):
        place = np.clip(place, 0, width - 1)
        value = np.where(there, np.take_along_axis(disparity, place, 1), np.inf)
        nearest.append(value)
        continued.append(value + np.take_along_axis(slope, place, 1) * (columns - place))
    behind = np.where(nearest[0] <= nearest[1], continued[0], continued[1])
    # A row without anything is as the nearest one that has something.
    behind = behind[rows[np.abs(np.arange(len(behind))[:, None] - rows).argmin(axis=1)]]
    smooth = cv2.medianBlur(np.maximum(behind, 0).astype(np.float32), 5)
    return np.where(known, disparity, smooth)


def _mean_slope(disparity: Array) -> Array:
    """Change of the disparity per pixel along the row, the mean around each pixel; 0 = unknown."""
    change = disparity[:, STEP:] - disparity[:, :-STEP]
    gentle = np.abs(change) < MAX_CHANGE
    sums = np.zeros((2, *disparity.shape), np.float32)
    middle = slice(STEP // 2, STEP // 2 + change.shape[1])
    sums[0, :, middle] = np.where(gentle, change / STEP, 0)
    sums[1, :, middle] = gentle
    total, count = (cv2.blur(one, (WINDOW, WINDOW)) for one in sums)
    return np.asarray(total / np.maximum(count, 0.05))
