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
from reconstruction.depth.sweep_engine import CPU

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
NEIGHBOURHOOD_PX = 4
"""Radius of the neighbourhood; every second pixel counts."""
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
    pixels = np.flatnonzero(cv2.dilate(jumps.astype(np.uint8), around)).astype(np.int32)
    found = floats(np.stack(surface))
    near, far = np.empty(len(pixels), np.float32), np.empty((3, len(pixels)), np.float32)
    given = *level.shape, found, ctypes.c_int64(len(pixels)), pixels, REACH_PX
    call_kernel("edge_sides", *given, near, far)
    apart = (far[0] > 0) & (near > (1 + MIN_DIFFERENCE) * far[0])
    pixels, near, far = pixels[apart], near[apart], far[:, apart]
    gain = np.zeros(level.shape, np.float32)
    gain.reshape(-1)[pixels] = _differences(level, pixels, near, source_views)
    gain.reshape(-1)[pixels] -= _differences(level, pixels, far[0], source_views)
    nearer = where.reshape(-1)[pixels] & (2 * level.reshape(-1)[pixels] > near + far[0])
    pixels, far = pixels[nearer], far[:, nearer]
    total, size, weight = sums = np.empty((3, len(pixels)), np.float32)
    call_kernel(
        "gather_gains",
        *(*level.shape, gain, floats(source_views[0].reference.grey), ctypes.c_int64(len(pixels)), pixels),
        *(NEIGHBOURHOOD_PX, ctypes.c_float(SIMILAR_GREY), ctypes.c_float(SIMILAR_PX), sums),
    )
    moved = (total > MIN_GAIN * weight) & (total > MIN_GAIN_FRACTION * size)
    found.reshape(4, -1)[:3, pixels[moved]] = far[:, moved]
    return Surface(*found)


def _differences(level: Array, pixels: Array, extended: Array, source_views: Sequence[SourceView]) -> Array:
    """Return pixels' mean difference in brightness (n,) from the best sources on an extended side."""
    surface = level.copy()
    surface.reshape(-1)[pixels] = extended
    found = []
    for view in source_views:
        seen, grey = CPU.warp(view, surface), view.reference.grey
        seen, grey = seen.reshape(-1), grey.reshape(-1)
        factor, bias = match_brightness(seen, grey, np.flatnonzero(seen > 0))
        off = np.abs(factor * seen[pixels] + bias - grey[pixels])
        found.append(np.where(seen[pixels] > 0, np.minimum(off, MAX_GREY_LEVELS), MAX_GREY_LEVELS))
    return np.asarray(np.sort(found, axis=0)[:MIN_SOURCES].mean(0))
