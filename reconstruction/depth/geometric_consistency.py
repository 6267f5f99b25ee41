"""Consistency check: depth is valid where other, independently matched views found the same surface."""

from collections.abc import Iterable

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import SourceView
from reconstruction.depth.plane_sweep import Surface
from reconstruction.depth.sweep_kernels import Agreement, compare_surfaces, warp

TYPICAL_WIDTH = 640
REPROJECTION_PX = 1.0
"""Maximum distance after projection to the other view and back; more in images wider than `TYPICAL_WIDTH`,
whose pixels are smaller than what windows can resolve."""
RELATIVE_DEPTH = 0.02
"""Maximum relative depth difference between views that agree."""
SURE_DEPTH = 0.01
"""Relative depth difference that always agrees, whatever its size in pixels at a wide angle."""
MAX_ANGLE_DEG = 45.0
"""Maximum angle between views; at larger angles they neither agree nor disagree."""
MAX_GREY_LEVELS = 10.0
"""Maximum difference in brightness (of 255) beyond the noise, after matching both images' brightness.

Without it different blank objects would agree."""
MAX_COST = 0.5
"""Maximum matching cost of a pixel that counts as evidence."""
MIN_ISLAND_PX = 50
"""Minimum size of an island of depth."""


def consistent_and_visible_views(
    surface: Surface,
    others: Iterable[tuple[SourceView, Surface]],
    relative_depth: float = RELATIVE_DEPTH,
) -> tuple[Array, Array]:
    """Count the other views whose surfaces agree at each pixel, and the views that could see it.

    Both counts are uint8 height x width. A view cannot see points outside its image, behind its own surface,
    or from a very different direction.
    """
    count, able = (np.zeros(surface.inverse_depth.shape, np.uint8) for _ in range(2))
    for source_view, other in others:
        same, sees = compare_surfaces(
            surface.inverse_depth, source_view, other.inverse_depth, _agreement(source_view, relative_depth)
        )
        count += same & _equally_bright(surface.inverse_depth, source_view, same)
        able += sees
    return count, able


def count_coinciding_views(surface: Surface, others: Iterable[tuple[SourceView, Surface]]) -> Array:
    """Count the other views whose surfaces agree at each pixel, of any brightness; uint8 height x width."""
    same = [
        compare_surfaces(surface.inverse_depth, source_view, other.inverse_depth, _agreement(source_view))[0]
        for source_view, other in others
    ]
    return np.asarray(np.sum(same, axis=0, dtype=np.uint8))


def _agreement(source_view: SourceView, relative_depth: float = RELATIVE_DEPTH) -> Agreement:
    pixels = REPROJECTION_PX * max(1.0, source_view.reference.view.width / TYPICAL_WIDTH)
    return Agreement(relative_depth, SURE_DEPTH, pixels, float(np.cos(np.radians(MAX_ANGLE_DEG))))


def remove_speckles(good: Array, inverse_depth: Array, smallest: int) -> Array:
    """Remove islands of fewer than `smallest` pixels from a mask; jumps of depth separate islands."""
    if not good.any():
        return good
    fraction = inverse_depth / float(inverse_depth[good].max())
    scaled = np.where(good, 1 + fraction * 16000, 0).clip(0, 20000).astype(np.int16)
    cv2.filterSpeckles(scaled, 0, smallest, 400)
    return np.asarray(scaled > 0)


def _equally_bright(inverse_depth: Array, source_view: SourceView, same: Array) -> Array:
    """Return where the other view, warped by the surface, is as bright as this one (bool, height x width)."""
    seen = warp(source_view, inverse_depth)
    reference = source_view.reference.grey
    gain, bias = match_brightness(seen.reshape(-1), reference.reshape(-1), np.flatnonzero(same))
    difference = cv2.blur(gain * seen + bias - reference, (5, 5))
    noise = float(np.sqrt(max(source_view.reference.noise, source_view.source.noise)))
    return np.asarray(np.abs(difference) < MAX_GREY_LEVELS + noise)


def match_brightness(seen: Array, reference: Array, pixels: Array) -> tuple[float, float]:
    """Return gain and bias between two images from percentiles at these pixels; exposures may differ."""
    if pixels.size < 100:
        return 1.0, 0.0
    some = pixels[:: max(1, pixels.size // 5_000)]
    a, b = (np.percentile(values[some], [10, 50, 90]) for values in (seen, reference))
    gain = float(np.clip((b[2] - b[0]) / max(a[2] - a[0], 1.0), 0.5, 2.0))
    return gain, float(b[1] - gain * a[1])
