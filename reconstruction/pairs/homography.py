"""The homography between two cameras' pictures, fitted to points that do not move."""

from dataclasses import dataclass

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.pairs.features import MIN_MATCHES


@dataclass(frozen=True)
class Homography:
    """The plane-to-plane map that fits most still points: 3x3, pixels of the first to the second camera."""

    matrix: Array
    overlap: float
    """Share of the first camera's picture that the second shows too."""
    inliers: int
    matches: int


def fit_homography(
    at_a: Array, at_b: Array, size_a: tuple[int, int], size_b: tuple[int, int]
) -> Homography | None:
    """The homography of two cameras from matched still points (n, 2), or None where nothing fits."""
    if len(at_a) < MIN_MATCHES:
        return None
    matrix, kept = cv2.findHomography(
        at_a.reshape(-1, 1, 2), at_b.reshape(-1, 1, 2), cv2.USAC_MAGSAC, 4.0, maxIters=5000, confidence=0.999
    )
    if matrix is None or int(kept.sum()) < MIN_MATCHES or abs(np.linalg.det(matrix)) < 1e-9:
        return None
    overlap = _overlap(np.linalg.inv(matrix), size_b, size_a)
    return Homography(np.asarray(matrix), overlap, int(kept.sum()), len(at_a))


def _overlap(into: Array, size: tuple[int, int], frame: tuple[int, int]) -> float:
    """Share of a frame (width, height) that a picture of `size` covers after a homography into it."""
    mask = np.full((size[1], size[0]), 255, np.uint8)
    covered = cv2.warpPerspective(mask, into, frame, flags=cv2.INTER_NEAREST)
    return float((covered > 0).mean())
