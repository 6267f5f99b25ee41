"""Tracking of points from one image to another and back."""

import cv2
import numpy as np

from reconstruction.common.geometry import Array


def track_there_and_back(
    a: Array, b: Array, at: Array, window_px: int, levels: int = 3
) -> tuple[Array, Array]:
    """Track points (n, 2) from grey image a to b and back.

    Returns the points in b, and each one's distance from its start after returning, px (n,), infinite if
    tracking failed. The method is Lucas-Kanade, in a pyramid up to level `levels`.
    """
    start = at.astype(np.float32).reshape(-1, 1, 2)
    window = (window_px, window_px)
    there, found, _ = cv2.calcOpticalFlowPyrLK(a, b, start, None, winSize=window, maxLevel=levels)
    back, returned, _ = cv2.calcOpticalFlowPyrLK(b, a, there, None, winSize=window, maxLevel=levels)
    drift = np.linalg.norm((back - start).reshape(-1, 2), axis=1)
    return there.reshape(-1, 2), np.where((found.ravel() > 0) & (returned.ravel() > 0), drift, np.inf)
