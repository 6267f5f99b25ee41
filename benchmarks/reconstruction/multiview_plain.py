"""What the matcher is measured against: a sweep as one would write it at first, and SGBM of pairs."""

from itertools import pairwise

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View, other_from_reference
from reconstruction.stereo.matching import match_rectified
from reconstruction.stereo.stereo_pair import rectify

PLANES = 112
WINDOW = (7, 7)
SMALL, LARGE = 0.08, 0.8


def simple_sweep(
    views: dict[str, View], greys: dict[str, Array], nearest: float, farthest: float, reference: str
) -> Array:
    """Planes, correlation in a window, the two best sources, 4 paths, a parabola; two others must agree."""
    levels = np.linspace(1 / farthest, 1 / nearest, PLANES)
    found = {name: _one(name, views, greys, levels) for name in views}
    mine, view = found[reference], views[reference]
    count = np.zeros(mine.shape, int)
    points = (view.rays(view.grid()) * mine.reshape(-1, 1) - view.translation) @ view.rotation
    for name, other in views.items():
        if name == reference:
            continue
        there = points @ other.rotation.T + other.translation
        pixel = there @ other.matrix.T
        xs, ys = (
            (pixel[:, i] / np.maximum(pixel[:, 2], 1e-6)).astype(np.float32).reshape(mine.shape)
            for i in (0, 1)
        )
        seen = cv2.remap(found[name], xs, ys, cv2.INTER_NEAREST, borderValue=(0.0,))
        count += (seen > 0) & (
            np.abs(seen - there[:, 2].reshape(mine.shape)) < 0.015 * np.maximum(seen, 1e-6)
        )
    return np.where(count >= 2, mine, 0).astype(np.float32)


def sgbm_pairs(
    views: dict[str, View], pictures: dict[str, Array], *, padded: bool
) -> dict[tuple[str, str], Array]:
    """OpenCV's SGBM, both ways, of every two neighbours along x: depth on the first one's pixels.

    `padded`: with so many columns beside the picture as there are disparities, which SGBM leaves out.
    """
    ordered = sorted(views, key=lambda name: float(views[name].centre[0]))
    grey = {name: cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) for name, picture in pictures.items()}
    found = {}
    for pair in pairwise(ordered):
        for first, second in (pair, pair[::-1]):
            baseline = float(np.linalg.norm(views[first].centre - views[second].centre))
            count = int(np.ceil(views[first].focal * baseline / 1.6 / 16)) * 16
            canvas = rectify(views[first], views[second], (0.0, float(count) if padded else 0.0))
            a, b = canvas.remap(grey[first])[0], canvas.remap(grey[second], other=True)[0]
            found[first, second] = canvas.depth(np.nan_to_num(match_rectified(a, b, 0, count)))
    return found


def _one(name: str, views: dict[str, View], greys: dict[str, Array], levels: Array) -> Array:
    view, grey = views[name], greys[name]
    height, width = grey.shape
    mean = cv2.blur(grey, WINDOW)
    variance = cv2.blur(grey * grey, WINDOW) - mean**2
    costs = np.empty((height, width, len(levels)), np.float32)
    inverse = np.linalg.inv(view.matrix)
    for number, level in enumerate(levels):
        unlike = []
        for other in views:
            if other == name:
                continue
            turn, shift = other_from_reference(view, views[other])
            plane = views[other].matrix @ (turn + np.outer(shift, [0, 0, level])) @ inverse
            seen = cv2.warpPerspective(
                greys[other], plane, (width, height), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_CONSTANT, borderValue=-1000.0,
            )  # fmt: skip
            mean_seen = cv2.blur(seen, WINDOW)
            spread = np.sqrt(np.maximum(variance * (cv2.blur(seen * seen, WINDOW) - mean_seen**2), 1.0))
            correlation = (cv2.blur(grey * seen, WINDOW) - mean * mean_seen) / spread
            correlation[mean_seen < 0] = -1
            unlike.append(1 - np.clip(correlation, -1, 1))
        costs[:, :, number] = np.sort(np.stack(unlike), 0)[:2].mean(0)
    total = np.zeros_like(costs)
    for turned in (False, True):
        for way in (1, -1):
            if turned:
                _paths(costs.transpose(1, 0, 2)[::way], total.transpose(1, 0, 2)[::way], grey.T[::way])
            else:
                _paths(costs[::way], total[::way], grey[::way])
    best = np.clip(total.argmin(-1), 1, len(levels) - 2)[..., None]
    before, here, after = (np.take_along_axis(total, best + k, -1)[..., 0] for k in (-1, 0, 1))
    part = np.clip(0.5 * (before - after) / np.maximum(before - 2 * here + after, 1e-6), -0.5, 0.5)
    depth = 1 / (levels[0] + (best[..., 0] + part) * (levels[1] - levels[0]))
    alike = 1 - np.take_along_axis(costs, best, -1)[..., 0]
    return np.where(alike > 0.25, depth, 0).astype(np.float32)


def _paths(costs: Array, total: Array, grey: Array) -> None:
    last = costs[0].copy()
    total[0] += last
    for row in range(1, len(costs)):
        lowest = last.min(-1, keepdims=True)
        jump = np.clip(LARGE / (1 + np.abs(grey[row] - grey[row - 1]) / 8), 1.5 * SMALL, None)[:, None]
        now = np.minimum(last, lowest + jump)
        now[:, 1:] = np.minimum(now[:, 1:], last[:, :-1] + SMALL)
        now[:, :-1] = np.minimum(now[:, :-1], last[:, 1:] + SMALL)
        last = now - lowest + costs[row]
        total[row] += last
