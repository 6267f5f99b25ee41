"""Disparities to a fraction of a pixel: the shift that is left between the pictures, and smooth surfaces.

SGBM's own parabola pulls disparities towards whole pixels (Szeliski and Scharstein 2004).
"""

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.stereo.sgbm import warp_by_disparity

SURFACE_PX = 1.0
"""How far neighbours on one surface lie from each other, standard deviation in px of disparity."""
REACH_PX = 5.0
"""Over how many pixels a surface is smoothed, standard deviation; the window is as wide."""
WINDOW = 7
"""Side of the window over which the left shift is measured, px."""
MAX_SHIFT_PX = 0.5
WEAK_GRADIENT = 20.0
"""Squared change of brightness per pixel ((grey levels)^2) at which half of a shift is believed."""


def refine_disparity(reference: Array, other: Array, disparity: Array) -> Array:
    """The disparity (float32 height x width, px, NaN = none) refined; NaN stays NaN.

    The pictures are a rectified pair, grey levels, equally bright.
    """
    smooth = _smooth_surfaces(disparity)
    return _smooth_surfaces(smooth + _left_shift(reference, other, smooth))


def _left_shift(reference: Array, other: Array, disparity: Array) -> Array:
    """The shift between the reference and the other picture warped onto it (Lucas and Kanade 1981), px."""
    seen = warp_by_disparity(other, disparity)
    slope = warp_by_disparity(cv2.Scharr(other.astype(np.float32), cv2.CV_32F, 1, 0, scale=1 / 32), disparity)
    there = np.isfinite(seen) & np.isfinite(slope)
    slope = np.where(there, slope, 0)
    left = np.where(there, reference - seen, 0).astype(np.float32)
    window = WINDOW, WINDOW
    left -= cv2.blur(left, window)
    steepness = cv2.blur(slope * slope, window) + WEAK_GRADIENT
    return np.asarray(np.clip(-cv2.blur(left * slope, window) / steepness, -MAX_SHIFT_PX, MAX_SHIFT_PX))


def _smooth_surfaces(disparity: Array) -> Array:
    known = np.isfinite(disparity)
    # So far from all that is known that it has no weight.
    nothing = np.float32(-50.0 * SURFACE_PX)
    smooth = cv2.bilateralFilter(
        np.where(known, disparity, nothing), 2 * round(REACH_PX) + 1, SURFACE_PX, REACH_PX
    )
    return np.where(known, smooth, np.nan).astype(np.float32)
