"""Pixels whose depth is valid: other views confirm it, or what lies around it and who can see it do."""

import ctypes

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.geometric_consistency import (
    MAX_COST,
    MIN_ISLAND_PX,
    RELATIVE_DEPTH,
    remove_speckles,
)
from reconstruction.depth.kernels import call_kernel, floats
from reconstruction.depth.plane_sweep import Surface

SUPPORT_FRACTION = 0.7
"""Minimum valid fraction of the nearby surface, around a pixel that few views can see."""
SUPPORT_PLACES = 12
"""Minimum number of nearby samples on the surface; a few may be chance."""
MIN_VIEWS = 2
"""Number of views that must agree, or all if there are fewer."""
MAX_CARRY = 0.08
"""Maximum distance over which smoothness carries depth across a blank area, relative to the width."""
MAX_RIM = 0.005
"""Maximum distance of valid depth beyond evidence, relative to the width: windows match badly at edges."""
SUPPORT_PX = 15
"""Side of the neighbourhood of a pixel that few views can see."""


def consistent_pixels(
    surface: Surface, count: Array, able: Array, sources: int, blank: Array, *, has_thin: bool = False
) -> Array:
    """Return where depth is valid, bool height x width, from the votes of `sources` source views.

    Of the views that are `able` to see a pixel all but one must agree, and no more than `MIN_VIEWS`. One is
    enough if only two see it, as beside a near object. Then most of the neighbourhood must be valid too,
    because a moving object finds one view that agrees by chance. `blank` (bool): pixels without any detail,
    such as the dark behind an object. `has_thin` is the rough scene's.
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
    # Without thin things, small islands of depth mostly float.
    min_island_px = 16 if has_thin else MIN_ISLAND_PX
    return remove_speckles(agreed & carried, surface.inverse_depth, min_island_px)


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
    valid = evidence
    for kernel in (np.ones((1, radius + 1), np.uint8), np.ones((radius + 1, 1), np.uint8)):
        last = kernel.shape[1] - 1, kernel.shape[0] - 1
        ahead, back = (cv2.dilate(mask, kernel, anchor=anchor) for anchor in ((0, 0), last))
        valid = valid | (ahead & back > 0)
    return valid
