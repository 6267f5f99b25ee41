"""Consistency check: depth is valid where other, independently matched views found the same surface."""

import ctypes
from collections.abc import Iterable

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import SourceView
from reconstruction.depth.kernels import call_kernel, floats
from reconstruction.depth.plane_sweep import Surface
from reconstruction.depth.sweep_engine import CPU, Agreement, SweepEngine

TYPICAL_WIDTH = 640
SUPPORT_FRACTION = 0.7
"""Minimum valid fraction of the nearby surface, around a pixel that few views can see."""
SUPPORT_PLACES = 12
"""Minimum number of nearby samples on the surface; a few may be chance."""
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
MIN_VIEWS = 2
"""Number of views that must agree, or all if there are fewer."""
MAX_COST = 0.5
"""Maximum matching cost of a pixel that counts as evidence."""
MAX_CARRY = 0.08
"""Maximum distance over which smoothness carries depth across a blank area, relative to the width."""
MAX_RIM = 0.005
"""Maximum distance of valid depth beyond evidence, relative to the width: windows match badly at edges."""
MIN_ISLAND_PX = 50
"""Minimum size of an island of depth."""
SUPPORT_PX = 15
"""Side of the neighbourhood of a pixel that few views can see."""


def consistent_and_visible_views(
    surface: Surface,
    others: Iterable[tuple[SourceView, Surface]],
    relative_depth: float = RELATIVE_DEPTH,
    engine: SweepEngine = CPU,
) -> tuple[Array, Array]:
    """Count the other views whose surfaces agree at each pixel, and the views that could see it.

    Both counts are uint8 height x width. A view cannot see points outside its image, behind its own surface,
    or from a very different direction.
    """
    count, able = (np.zeros(surface.inverse_depth.shape, np.uint8) for _ in range(2))
    for source_view, other in others:
        same, sees = engine.compare(
            surface.inverse_depth, source_view, other.inverse_depth, _agreement(source_view, relative_depth)
        )
        count += same & _equally_bright(surface.inverse_depth, source_view, same)
        able += sees
    return count, able


def count_coinciding_views(surface: Surface, others: Iterable[tuple[SourceView, Surface]]) -> Array:
    """Count the other views whose surfaces agree at each pixel, of any brightness; uint8 height x width."""
    same = [
        CPU.compare(surface.inverse_depth, source_view, other.inverse_depth, _agreement(source_view))[0]
        for source_view, other in others
    ]
    return np.asarray(np.sum(same, axis=0, dtype=np.uint8))


def _agreement(source_view: SourceView, relative_depth: float = RELATIVE_DEPTH) -> Agreement:
    pixels = REPROJECTION_PX * max(1.0, source_view.reference.view.width / TYPICAL_WIDTH)
    return Agreement(relative_depth, SURE_DEPTH, pixels, float(np.cos(np.radians(MAX_ANGLE_DEG))))


def consistent_pixels(surface: Surface, count: Array, able: Array, sources: int, blank: Array) -> Array:
    """Return where depth is valid, bool height x width, from the votes of `sources` source views.

    Of the views that are `able` to see a pixel all but one must agree, and no more than `MIN_VIEWS`. One is
    enough if only two see it, as beside a near object. Then most of the neighbourhood must be valid too,
    because a moving object finds one view that agrees by chance. `blank` (bool): pixels without any detail,
    such as the dark behind an object.
    """
    required = min(MIN_VIEWS, max(1, sources - 1))
    agreed = count >= required
    few = count >= np.clip(able.astype(np.int16) - 1, 1, required)
    unsure = np.nonzero(few & ~agreed)
    agreed[unsure] = _valid_fraction(few | agreed, surface, unsure) > SUPPORT_FRACTION
    evidence = agreed & (surface.cost < MAX_COST)
    # A single pixel of low cost may be chance: real evidence comes in patches.
    evidence = cv2.blur(evidence.astype(np.float32), (5, 5)) > 0.4
    distance = cv2.distanceTransform((~evidence).astype(np.uint8), cv2.DIST_L2, 5) / evidence.shape[1]
    carried = (distance <= MAX_RIM) | _between(evidence, round(MAX_CARRY * evidence.shape[1]))
    carried |= ~blank & (distance < MAX_CARRY)
    return remove_speckles(agreed & carried, surface.inverse_depth, MIN_ISLAND_PX)


def _valid_fraction(valid: Array, surface: Surface, pixels: tuple[Array, ...]) -> Array:
    """Return the valid fraction of the surface around pixels at these rows and columns (n,).

    Pixels on other surfaces, such as the background beyond an edge, do not count.
    """
    flat = np.ravel_multi_index(pixels, valid.shape).astype(np.int32)
    places, there = (np.empty(len(flat), np.int32) for _ in range(2))
    call_kernel(
        "support",
        *(*valid.shape, floats(np.stack(surface[:3])), valid, ctypes.c_int64(len(flat)), flat),
        *(SUPPORT_PX // 2, ctypes.c_float(RELATIVE_DEPTH), places, there),
    )
    return there / np.maximum(places, SUPPORT_PLACES)


def _between(evidence: Array, radius: int) -> Array:
    """Return pixels (bool) with evidence on both sides in their row or column, at most `radius` px away.

    With evidence on one side only, smoothness would extend an object beyond its edge, into the dark.
    """
    mask = evidence.astype(np.uint8)
    found = evidence
    for kernel in (np.ones((1, radius + 1), np.uint8), np.ones((radius + 1, 1), np.uint8)):
        last = kernel.shape[1] - 1, kernel.shape[0] - 1
        ahead, back = (cv2.dilate(mask, kernel, anchor=anchor) for anchor in ((0, 0), last))
        found = found | (ahead & back > 0)
    return found


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
    seen = CPU.warp(source_view, inverse_depth)
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
