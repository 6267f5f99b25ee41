"""Edges of surfaces, moved to where pixels match: windows give a near surface's depth to pixels beside it."""

import math
from collections.abc import Sequence
from itertools import product

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import SourceView
from reconstruction.depth.compiled import CPU
from reconstruction.depth.geometric_consistency import match_brightness
from reconstruction.depth.plane_sweep import Surface

REACH_PX = 4
"""Maximum distance by which an edge moves; windows have a side of 7 px."""
MIN_JUMP = 0.04
"""Minimum relative jump of inverse depth between neighbouring pixels at an edge."""
MIN_DIFFERENCE = 0.03
"""Minimum relative difference between the surfaces on both sides of a pixel."""
MAX_GREY_LEVELS = 20.0
"""Maximum difference in brightness (of 255) that counts."""
SIMILAR_GREY, SIMILAR_PX = 8.0, 4.0
"""Differences in brightness and place at which a neighbour's weight falls to 1/e."""
NEIGHBOURHOOD = range(-4, 5, 2)
MIN_GAIN, MIN_GAIN_FRACTION = 1.0, 0.35
"""Minimum mean gain for the farther surface in grey levels, and relative to the mean of all gains' sizes."""
MIN_SOURCES = 2
"""Number of best sources that count, as the others may not see the farther surface."""


def sharpen_edges(surface: Surface, source_views: Sequence[SourceView], where: Array) -> Surface:
    """Return the surface with pixels beside a jump of depth on its farther side if they match better there.

    Both sides' planes are extended over `REACH_PX`. Each pixel is compared with the sources by its own
    brightness on both, and the gain is averaged over neighbours that are as bright (Yoon and Kweon 2006).
    Only pixels of the mask `where` (bool) move.
    """
    level = surface.inverse_depth
    around, small = np.ones((2 * REACH_PX - 1,) * 2, np.uint8), np.ones((3, 3), np.uint8)
    jumps = where & (cv2.dilate(level, small) > (1 + MIN_JUMP) * cv2.erode(level, small))
    pixels = np.nonzero(cv2.dilate(jumps.astype(np.uint8), around))
    near, far = _both_sides(surface, pixels)
    apart = (far[0] > 0) & (near > (1 + MIN_DIFFERENCE) * far[0])
    pixels = tuple(axis[apart] for axis in pixels)
    near, far = near[apart], far[:, apart]
    gain = np.zeros(level.shape, np.float32)
    gain[pixels] = _differences(level, pixels, near, source_views)
    gain[pixels] -= _differences(level, pixels, far[0], source_views)
    nearer = where[pixels] & (2 * level[pixels] > near + far[0])
    pixels, far = tuple(axis[nearer] for axis in pixels), far[:, nearer]
    moved = _gains(gain, source_views[0].reference.grey, pixels)
    found = np.stack(surface)
    found[:3, pixels[0][moved], pixels[1][moved]] = far[:, moved]
    return Surface(*found)


def _both_sides(surface: Surface, pixels: tuple[Array, ...]) -> tuple[Array, Array]:
    """Return the nearest level (n,) and the farthest plane (3, n) around pixels, extended to these."""
    height, width = surface.inverse_depth.shape
    around = REACH_PX, REACH_PX
    planes = np.pad(surface[:3], ((0, 0), around, around), "edge")
    # Beyond the image its outermost planes go on.
    for axis, size in ((1, width), (2, height)):
        beyond = np.arange(-REACH_PX, size + REACH_PX, dtype=np.float32)
        beyond -= beyond.clip(0, size - 1)
        planes[0] += planes[axis] * (beyond if axis == 1 else beyond[:, None])
    wide = width + 2 * REACH_PX
    farthest = own = (pixels[0] + REACH_PX) * wide + pixels[1] + REACH_PX
    near = far = planes[0].take(own)
    for off in (REACH_PX, REACH_PX // 2):
        for dy, dx in product((-off, 0, off), repeat=2):
            at = own + (dy * wide + dx)
            level, slope_x, slope_y = (part.take(at) for part in planes)
            level -= slope_x * dx + slope_y * dy
            near = np.maximum(near, level)
            farthest = np.where(level < far, at, farthest)
            far = np.minimum(far, level)
    return near, np.stack([far, *(part.take(farthest) for part in planes[1:])])


def _differences(
    level: Array, pixels: tuple[Array, ...], extended: Array, source_views: Sequence[SourceView]
) -> Array:
    """Return pixels' mean difference in brightness (n,) from the best sources on an extended side."""
    surface = level.copy()
    surface[pixels] = extended
    found = []
    for view in source_views:
        seen, grey = CPU.warp(view, surface), view.reference.grey
        factor, bias = match_brightness(seen.reshape(-1), grey.reshape(-1), np.flatnonzero(seen > 0))
        off = np.abs(factor * seen[pixels] + bias - grey[pixels])
        found.append(np.where(seen[pixels] > 0, np.minimum(off, MAX_GREY_LEVELS), MAX_GREY_LEVELS))
    return np.asarray(np.sort(found, axis=0)[:MIN_SOURCES].mean(0))


def _gains(gain: Array, grey: Array, pixels: tuple[Array, ...]) -> Array:
    """Return the pixels (n,) that gain, together with those around that are as bright."""
    margin = NEIGHBOURHOOD[-1]
    wide_gain, wide_grey = (np.pad(part, margin) for part in (gain, grey))
    width, own = wide_grey.shape[1], grey[pixels]
    total, size, weight = (np.full(len(own), 1e-9, np.float32) for _ in range(3))
    for dy, dx in product(NEIGHBOURHOOD, repeat=2):
        at = (pixels[0] + (margin + dy)) * width + (pixels[1] + (margin + dx))
        theirs = wide_gain.take(at)
        alike = np.exp(-np.abs(wide_grey.take(at) - own) / SIMILAR_GREY - math.hypot(dx, dy) / SIMILAR_PX)
        alike *= theirs != 0
        total += alike * theirs
        size += alike * np.abs(theirs)
        weight += alike
    return np.asarray((total > MIN_GAIN * weight) & (total > MIN_GAIN_FRACTION * size))
