"""Camera pairs: matches of points at rest, homographies, and suitability for depth or a panorama."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import combinations
from operator import itemgetter

import cv2
import numpy as np

from capture_app.session.exporting.descriptor_matches import match_descriptors
from reconstruction.common.geometry import Array, View, angle_deg, angles_deg, other_from_reference

MAX_SIDE_PX = 1280
"""Longer side to which images are reduced for detecting points."""
CLEAR_CONTRAST, FAINT_CONTRAST = 0.02, 0.01
"""Minimum contrast of points at rest, and of points on moving objects, which may be small."""
STILL_RATIO = 0.75
"""Maximum ratio of a static match's distance to the second best's."""
MIN_MATCHES = 25
"""Minimum number of matches of two cameras that overlap."""
GRID = (8, 6)
"""Cells across and down of the grid that measures how features cover an image."""
MAX_CANVAS_FRACTION = 8.0
"""Maximum canvas area, in reference images: cameras that look some 60 degrees off their common plane."""
OVERLAP_LIMITS = (0.15, 0.8)
"""Minimum and maximum fraction of an image that its neighbour in a panorama overlaps."""
EPIPOLAR_PX = 3.0
"""Maximum epipolar error of a match."""


@dataclass(frozen=True, eq=False)
class Features:
    """Points of one image: positions (n, 2) px in the full image, descriptors (n, 128), contrast (n,)."""

    positions: Array
    descriptors: Array
    contrast: Array

    def at_rest(self, moving: Array) -> "Features":
        """Return the features of clear contrast outside a mask (bool) of the full image."""
        height, width = moving.shape
        columns, rows = np.floor(self.positions + 0.5).astype(int).clip(0, (width - 1, height - 1)).T
        still = (self.contrast >= CLEAR_CONTRAST) & ~moving[rows, columns]
        return Features(self.positions[still], self.descriptors[still], self.contrast[still])


def size_above_features(width: int, height: int) -> float:
    """Return the ratio of an image's size to the size at which its points are detected; 1 for small ones."""
    return max(1.0, max(width, height) / MAX_SIDE_PX)


def detect_features(
    image: Array,
    side_px: int = MAX_SIDE_PX,
    points: int = 2500,
    contrast: float = CLEAR_CONTRAST,
    *,
    allowed: Array | None = None,
) -> Features:
    """Detect SIFT points of a grey image (uint8), reduced to `side_px`.

    Returns at most `points` points, of at least `contrast`, inside the mask `allowed` (bool).
    """
    scale = min(1.0, side_px / max(image.shape))
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else image
    if allowed is not None:
        allowed = cv2.resize(allowed.astype(np.uint8), small.shape[::-1], interpolation=cv2.INTER_NEAREST)
    sift = cv2.SIFT.create(nfeatures=points, contrastThreshold=contrast)
    keypoints, descriptors = sift.detectAndCompute(small, allowed)
    if descriptors is None:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32), np.zeros(0))
    positions = np.array([(point.pt[0] + 0.5, point.pt[1] + 0.5) for point in keypoints]) / scale - 0.5
    # SIFT compares its threshold with the sum over its layers.
    contrasts = sift.getNOctaveLayers() * np.array([point.response for point in keypoints])
    return Features(positions, np.asarray(descriptors, np.float32), contrasts)


@lru_cache(maxsize=200)
def match_at_rest(a: Features, b: Features) -> tuple[Array, Array]:
    """Return the indices (n,) of static points that are each other's best match; cached for all callers."""
    return match_descriptors(a.descriptors, b.descriptors, STILL_RATIO)


def match_features(a: Features, b: Features) -> tuple[Array, Array]:
    """Return the positions (n, 2) of points that are each other's best match, in a and in b."""
    of_a, of_b = match_at_rest(a, b)
    return a.positions[of_a], b.positions[of_b]


def grid_cells(at: Array, width: int, height: int) -> set[tuple[int, int]]:
    """Return the cells of `GRID` that contain pixels (n, 2) of an image of this size."""
    cells = np.floor(at / (width, height) * GRID).clip(0, np.array(GRID) - 1).astype(int)
    return {(int(x), int(y)) for x, y in cells}


def fit_homography(
    at_a: Array, at_b: Array, size_a: tuple[int, int], size_b: tuple[int, int]
) -> tuple[float, float] | None:
    """Fit the homography of two cameras to matched static points (n, 2); None if nothing fits.

    Returns the fraction of the first camera's image that the second overlaps, and that of matches that fit.
    """
    if len(at_a) < MIN_MATCHES:
        return None
    matrix, inliers = cv2.findHomography(
        at_a.reshape(-1, 1, 2), at_b.reshape(-1, 1, 2), cv2.USAC_MAGSAC, 4.0, maxIters=5000, confidence=0.999
    )
    if matrix is None or int(inliers.sum()) < MIN_MATCHES or abs(np.linalg.det(matrix)) < 1e-9:
        return None
    covered = cv2.warpPerspective(
        np.ones(size_b[::-1], np.uint8), np.linalg.inv(matrix), size_a, flags=cv2.INTER_NEAREST
    )
    return float(covered.mean()), float(inliers.mean())


def rectifying_rotations(reference: View, other: View) -> tuple[Array, Array, float, bool]:
    """Return both views' rotations onto a common plane, the baseline's length, and whether to mirror.

    The common x axis is the baseline, directed along the reference's x (or y) axis so that images stay
    upright. The z axis is as close as possible to both viewing directions.

    Raises:
        ValueError: the two cameras are at the same place, or one looks along the baseline.
    """
    length = float(np.linalg.norm(other.centre - reference.centre))
    far = max(float(np.linalg.norm(reference.centre)), float(np.linalg.norm(other.centre)), 1.0)
    # Written this way, NaN is refused too.
    # Closer cameras are at the same place; the remaining distance is rounding error.
    if not length > 1e-6 * far:
        raise ValueError(f"both cameras stand at the same place by the calibration (baseline {length:.2g})")
    rotation, translation = other_from_reference(reference, other)
    x = -rotation.T @ translation / length
    mirror = bool(x[np.argmax(np.abs(x[:2]))] < 0)
    x = -x if mirror else x
    z = np.array([0.0, 0.0, 1.0]) + rotation[2]
    z -= (z @ x) * x
    if np.linalg.norm(z) < 0.2:
        raise ValueError(f"the cameras stand one behind the other (baseline {length:.3g})")
    z /= np.linalg.norm(z)
    reference_rotation = np.stack([x, np.cross(z, x), z])
    return reference_rotation, reference_rotation @ rotation.T, length, mirror


def canvas_bounds(reference: View, other: View) -> tuple[Array, Array]:
    """Return the minimum and maximum x and y of the reference's image on the common plane, px from centre.

    The canvas is not mirrored, and has the reference's own resolution.

    Raises:
        ValueError: the pair cannot be rectified, or its canvas is too large; the message has sizes.
    """
    rotation, _, length, _ = rectifying_rotations(reference, other)
    rays = reference.rays(reference.border()) @ rotation.T
    aside = (
        f"baseline {length:.3g}, viewing directions {angle_deg(reference.axis, other.axis):.0f} degrees apart"
    )
    # With a smaller cosine the ray runs along the plane.
    if not (rays[:, 2] / np.linalg.norm(rays, axis=1)).min() > 0.05:
        raise ValueError(
            f"their pictures have no common plane: it would take a canvas without bounds ({aside})"
        )
    flat = rays[:, :2] / rays[:, 2:] * reference.focal
    wide, tall = np.ptp(flat, axis=0)
    if wide * tall > MAX_CANVAS_FRACTION * reference.width * reference.height:
        raise ValueError(
            f"rectified, a picture of {reference.width}x{reference.height} pixels would become "
            f"{wide:.0f}x{tall:.0f} ({aside})"
        )
    return flat.min(0), flat.max(0)


@dataclass(frozen=True)
class PairChoice:
    """A pair of cameras, or None, and the reason.

    `left_out`: reasons why pairs can never give depth, by two names with a comma between.
    """

    cameras: tuple[str, str] | None
    why: str
    left_out: Mapping[str, str] = field(default_factory=dict)


def choose_stereo_pair(views: Mapping[str, View], points: Mapping[str, Features]) -> PairChoice:
    """Choose the pair with the most in common, enough parallax and nearly parallel axes.

    The score is the fraction of the image with matched static points times a factor. The factor rises with
    parallax (depth needs it) and falls beyond 10 degrees (matching suffers). Pairs that cannot be rectified
    are left out.
    """
    why = (
        f"no two cameras have {MIN_MATCHES} points at rest in common: their views are too different, or the "
        "static scene has no texture"
    )
    # Pairs that fit come first, by score; then those that do not, by their number of points.
    ranked: list[tuple[tuple[int, float], PairChoice]] = [((0, 0.0), PairChoice(None, why))]
    left_out = {}
    for a, b in combinations((name for name in points if name in views), 2):
        try:
            canvas_bounds(views[a], views[b])
        except ValueError as error:
            left_out[f"{a},{b}"] = str(error)
            continue
        at_a, at_b = match_features(points[a], points[b])
        fits = _near_epipolar_lines(views[a], views[b], at_a, at_b)
        if fits.sum() >= MIN_MATCHES:
            score, text = _stereo_score(views[a], views[b], at_a[fits], at_b[fits])
            ranked.append(((2, score), PairChoice((a, b), text)))
        elif len(fits) >= MIN_MATCHES:
            text = (
                f"{a} and {b} have {len(fits)} points at rest in common, but only {fits.sum()} within "
                f"{EPIPOLAR_PX:g} pixels of their epipolar lines: the calibration does not fit the pictures"
            )
            ranked.append(((1, len(fits)), PairChoice(None, text)))
    _, choice = max(ranked, key=itemgetter(0))
    if choice.cameras is None and left_out:
        choice = PairChoice(None, f"{choice.why}; {describe_left_out(left_out)}")
    return replace(choice, left_out=left_out)


def describe_left_out(left_out: Mapping[str, str]) -> str:
    """Describe why pairs are left out, naming three of them."""
    first, others = [f"{pair}: {why}" for pair, why in left_out.items()][:3], len(left_out) - 3
    return "; ".join([*first, f"and {others} more pairs"] if others > 0 else first)


def _near_epipolar_lines(a: View, b: View, at_a: Array, at_b: Array) -> Array:
    """Return which matches (n, 2) px are within `EPIPOLAR_PX` of their epipolar lines in the second view."""
    rotation, translation = other_from_reference(a, b)
    rays = b.rays(at_b)
    normals = np.cross(translation, a.rays(at_a) @ rotation.T)
    off = np.abs((rays * normals).sum(1)) / np.maximum(np.linalg.norm(normals[:, :2], axis=1), 1e-12)
    return np.asarray(off * b.focal < EPIPOLAR_PX)


def _stereo_score(a: View, b: View, at_a: Array, at_b: Array) -> tuple[float, str]:
    rotation, apart = other_from_reference(a, b)[0], b.centre - a.centre
    parallax = float(np.median(angles_deg(a.rays(at_a) @ rotation.T, b.rays(at_b))))
    shared = len(grid_cells(at_a, a.width, a.height)) / math.prod(GRID)
    ahead = abs(float(a.axis @ apart)) / float(np.linalg.norm(apart))
    # Beyond ten degrees two views look too different for dense matching.
    score = shared * (1 - np.exp(-parallax / 1.5)) * np.exp(-((parallax / 10) ** 2))
    step = np.abs(a.rotation @ apart)[:2]
    slant = float(step.min() / max(float(np.hypot(*step)), 1e-12))
    # A slanted baseline rotates the rectified images: more empty corners, and harder to look at.
    score *= (1 - ahead**2) * np.exp(-((angle_deg(a.axis, b.axis) / 25) ** 2)) * (1 - slant)
    why = f"{100 * shared:.0f} % of the picture with things both see, {parallax:.1f}° of parallax"
    return float(score), why


def choose_panorama_pair(points: Mapping[str, Features], sizes: Mapping[str, tuple[int, int]]) -> PairChoice:
    """Choose the two cameras whose panorama shows the most, if they still overlap and have little parallax.

    The score is the part of one image that the other does not show, times the fraction of static points that
    one homography explains. That fraction falls as the distance of the cameras grows.
    """
    pairs = {
        (a, b): fit
        for a, b in combinations(points, 2)
        if (fit := fit_homography(*match_features(points[a], points[b]), sizes[a], sizes[b])) is not None
    }
    scores = {
        pair: (1 - overlap) * fitting
        for pair, (overlap, fitting) in pairs.items()
        if OVERLAP_LIMITS[0] <= overlap <= OVERLAP_LIMITS[1]
    }
    if scores:
        best = max(scores, key=scores.__getitem__)
        return PairChoice(best, f"{100 * pairs[best][0]:.0f} % overlap")
    if pairs:
        shared_pct = 100 * min(overlap for overlap, _ in pairs.values())
        why = f"the cameras show too much of the same ({shared_pct:.0f} % or more) for a panorama"
        return PairChoice(None, f"{why} to show anything new")
    return PairChoice(None, "no two cameras' pictures can be laid over each other")
