"""Where the pictures of a panorama belong: cameras that only turn, found by what stands still.

Brown and Lowe, Automatic Panoramic Image Stitching using Invariant Features, 2007, by OpenCV.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.pairs.features import MIN_MATCHES, Features, match_features
from reconstruction.panorama.camera_estimate import PictureOverlap, estimate_cameras, long_view

INLIER_PX = 3.0


@dataclass(frozen=True)
class Registration:
    """By camera: its intrinsics and `rotation`, camera from panorama; there is no translation."""

    views: dict[str, View]
    left_out: dict[str, str]
    """Pictures that do not belong to it, and why."""


def register_pictures(
    points: Mapping[str, Features], sizes: Mapping[str, tuple[int, int]], known: Mapping[str, View]
) -> Registration:
    """Register pictures of these sizes (width, height) by their still points.

    `known` are calibrated views of these sizes: where all pictures have one, focal length and distortion are
    theirs, else estimated and none.

    Raises:
        ValueError: no two pictures belong together, or no camera that only turns explains them.
    """
    calibrated = all(name in known for name in points)
    views = {name: known[name] if calibrated else long_view(*sizes[name]) for name in points}
    flat = {
        name: Features(flat_pixels(views[name], p.positions), p.descriptors) for name, p in points.items()
    }
    overlaps = {
        (a, b): _find_overlap(match_features(flat[a], flat[b]), views[a], views[b])
        for a, b in combinations(points, 2)
    }
    used = _largest_group(list(points), overlaps)
    if len(used) < 2:
        most = max((len(one.fits) for one in overlaps.values()), default=0)
        if most < MIN_MATCHES:
            raise ValueError(f"no two pictures share more than {most} points")
        raise ValueError("the points that the pictures share do not fit a camera that only turns")
    left_out = {name: _reason_left_out(name, points[name], overlaps) for name in points if name not in used}
    return Registration(
        estimate_cameras({name: views[name] for name in used}, overlaps, calibrated), left_out
    )


def flat_pixels(view: View, at: Array) -> Array:
    """Pixels (n, 2) as they would be without the lens's distortion."""
    return np.asarray((view.rays(at) @ view.matrix.T)[:, :2]) if len(at) else at


def _find_overlap(at: tuple[Array, Array], a: View, b: View) -> PictureOverlap:
    nothing = PictureOverlap(at, np.zeros(len(at[0]), bool), np.eye(3))
    if len(at[0]) < MIN_MATCHES:
        return nothing
    middles = [np.array([view.width / 2, view.height / 2]) for view in (a, b)]
    centred = [(pixels - middle).reshape(-1, 1, 2) for pixels, middle in zip(at, middles, strict=True)]
    found, fits = cv2.findHomography(
        centred[0], centred[1], cv2.USAC_MAGSAC, INLIER_PX, maxIters=5000, confidence=0.999
    )
    if found is None or abs(np.linalg.det(found)) < 1e-9:
        return nothing
    return PictureOverlap(at, np.asarray(fits).ravel() > 0, np.asarray(found))


def _largest_group(names: Sequence[str], overlaps: Mapping[tuple[str, str], PictureOverlap]) -> list[str]:
    """The most pictures that belong together, each by an overlap with another."""
    group = {name: {name} for name in names}
    for (a, b), overlap in overlaps.items():
        if overlap.confidence > 1 and group[a] is not group[b]:
            group[a] |= group[b]
            for name in group[b]:
                group[name] = group[a]

    def support(members: set[str]) -> int:
        return sum(int(one.fits.sum()) for pair, one in overlaps.items() if members.issuperset(pair))

    best = max(group.values(), key=lambda members: (len(members), support(members)))
    return [name for name in names if name in best]


def _reason_left_out(name: str, own: Features, overlaps: Mapping[tuple[str, str], PictureOverlap]) -> str:
    if len(own.positions) < MIN_MATCHES:
        return f"it has too few features ({len(own.positions)})"
    shared = {a if b == name else b: len(one.fits) for (a, b), one in overlaps.items() if name in (a, b)}
    nearest = max(shared, key=lambda other: shared[other])
    if shared[nearest] < MIN_MATCHES:
        return f"it shares at most {shared[nearest]} points with another picture ({nearest})"
    return f"it shares {shared[nearest]} points with {nearest}, but does not fit beside it"
