"""Points of one picture found again in another, and back from there."""

import cv2
import numpy as np

from reconstruction.common.geometry import Array


def track_there_and_back(
    a: Array, b: Array, at: Array, window_px: int, levels: int = 3
) -> tuple[Array, Array]:
    """Where points (n, 2) of a grey picture lie in another, and how far from its start each returns, px (n,).

    The latter is infinite where a point is lost. By Lucas and Kanade, in a pyramid of so many levels.
    """
    start = at.astype(np.float32).reshape(-1, 1, 2)
    window = (window_px, window_px)
    there, found, _ = cv2.calcOpticalFlowPyrLK(a, b, start, None, winSize=window, maxLevel=levels)
    back, returned, _ = cv2.calcOpticalFlowPyrLK(b, a, there, None, winSize=window, maxLevel=levels)
    away = np.linalg.norm((back - start).reshape(-1, 2), axis=1)
    return there.reshape(-1, 2), np.where((found.ravel() > 0) & (returned.ravel() > 0), away, np.inf)
