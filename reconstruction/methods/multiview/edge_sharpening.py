"""Edges of surfaces, moved to where pixels match: windows give a near surface's depth to pixels beside it."""

import ctypes
from collections.abc import Sequence

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import SourceView
from reconstruction.depth.geometric_consistency import match_brightness
from reconstruction.depth.kernels import call_kernel, floats
from reconstruction.depth.plane_sweep import Surface
from reconstruction.depth.sweep_kernels import warp

REACH_PX = 4
"""Maximum distance by which an edge moves; windows have a side of 7 px."""
MIN_JUMP = 0.04
"""Minimum relative jump of inverse depth between neighbouring pixels at an edge."""
MIN_DIFFERENCE = 0.03
"""Minimum relative difference between the surfaces on both sides of a pixel."""
MAX_COST = 0.4
"""Maximum matching cost (0 to 1) of a pixel that moves; windows widen surfaces that match, and where nothing
matches, edges are chance."""
NEIGHBOURHOOD_PX = 8
"""Radius of the neighbourhood; every second pixel counts."""
GAIN_WEIGHT = 0.2
"""Weight of a gain by one grey level, beside the logarithm of the sides' ratio."""
FAR_PRIOR = 0.5
"""Preference for the farther side: windows widen near surfaces, and seldom far ones."""


def _weights() -> Array:
    """Return neighbours' weights by distance in y and x, then by the sum of their colour differences."""
    # A weight falls to 1/e within 6 px, and by a difference of 10 grey levels (mean of three colours).
    steps = np.arange(0, NEIGHBOURHOOD_PX + 1, 2)
    by_place = np.exp(-np.hypot(steps[:, None], steps) / 6).reshape(-1)
    return floats(np.concatenate([by_place, np.exp(-np.arange(3 * 255 + 1) / (3 * 10))]))


LIKENESS = _weights()


def depth_edges(level: Array) -> Array:
    """Return the pixels (bool) beside which the inverse depth jumps."""
    around = np.ones((3, 3), np.uint8)
    return np.asarray(cv2.dilate(level, around) > (1 + MIN_JUMP) * cv2.erode(level, around))


def sharpen_edges(surface: Surface, source_views: Sequence[SourceView], where: Array) -> Surface:
    """Return the surface with pixels beside a jump of depth moved to its farther side where likely.

    Both sides' planes are extended over `REACH_PX`. A pixel is likely on the side of the neighbours that have
    its colour (weights of Yoon and Kweon 2006), and on the farther side if single pixels match the sources
    better there. Only pixels of the mask `where` (bool) move.
    """
    level = surface.inverse_depth
    around = np.ones((2 * REACH_PX - 1,) * 2, np.uint8)
    edges = cv2.dilate((where & depth_edges(level)).astype(np.uint8), around)
    pixels = np.flatnonzero(edges).astype(np.int32)
    sharpened = floats(np.stack(surface))
    near, far = np.empty(len(pixels), np.float32), np.empty((3, len(pixels)), np.float32)
    given = *level.shape, sharpened, ctypes.c_int64(len(pixels)), pixels, REACH_PX
    call_kernel("edge_sides", *given, near, far)
    apart = (far[0] > 0) & (near > (1 + MIN_DIFFERENCE) * far[0])
    pixels, near, far = pixels[apart], near[apart], far[:, apart]
    gain = np.zeros(level.shape, np.float32)
    gain.reshape(-1)[pixels] = _differences(level, pixels, near, source_views)
    gain.reshape(-1)[pixels] -= _differences(level, pixels, far[0], source_views)
    movable = (where & (surface.cost < MAX_COST)).reshape(-1)
    nearer = movable[pixels] & (2 * level.reshape(-1)[pixels] > near + far[0])
    pixels, near, far = pixels[nearer], near[nearer], far[:, nearer]
    sums = np.empty((4, len(pixels)), np.float32)
    call_kernel(
        "weigh_sides",
        *(*level.shape, sharpened[0], gain, source_views[0].reference.coloured),
        *(ctypes.c_int64(len(pixels)), pixels, (near + far[0]) / 2, NEIGHBOURHOOD_PX, LIKENESS, sums),
    )
    farther, nearby, gained, judged = sums
    # A pixel that itself matches better nearer stays there: few neighbours are as a thin thing is.
    # Added to both sides: one without neighbours is not impossible.
    few = 0.05
    likely = np.log((farther + few) / (nearby + few)) + GAIN_WEIGHT * (
        gained / np.maximum(judged, 1e-3) + np.minimum(gain.reshape(-1)[pixels], 0)
    )
    moved = likely > -FAR_PRIOR
    sharpened.reshape(4, -1)[:3, pixels[moved]] = far[:, moved]
    return Surface(*sharpened)


def _differences(level: Array, pixels: Array, extended: Array, source_views: Sequence[SourceView]) -> Array:
    """Return pixels' mean difference in brightness (n,) from the best sources on an extended side."""
    surface = level.copy()
    surface.reshape(-1)[pixels] = extended
    edges = []
    for view in source_views:
        seen, grey = warp(view, surface), view.reference.grey
        seen, grey = seen.reshape(-1), grey.reshape(-1)
        factor, bias = match_brightness(seen, grey, np.flatnonzero(seen > 0))
        off = np.abs(factor * seen[pixels] + bias - grey[pixels])
        edges.append(np.where(seen[pixels] > 0, np.minimum(off, 20.0), 20.0))
    # The others may not see the farther surface.
    return np.asarray(np.sort(edges, axis=0)[:2].mean(0))
