"""Disparities of a rectified pair by OpenCV's semi-global block matching (SGBM), checked and refined.

SGBM's own parabola biases disparities towards whole pixels (Szeliski and Scharstein 2004). The remaining
shift between the images is therefore measured, and surfaces are smoothed.
"""

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.common.image_matching import noise_level

BLOCK = 3
"""Side of the matched window, px."""

BYTES_PER_PIXEL = 160
"""Memory per pixel for matching and its checks (measured); only some rows of costs are stored."""
CHECK_WINDOW = 9
"""Side of the window in which the two views are correlated, px."""
MAX_LEFT_RIGHT_PX = 1.0
"""Difference between the disparities of both directions up to which a match is accepted."""
MAX_GREY_DIFFERENCE = 10.0
"""Mean brightness difference beyond noise and half a pixel up to which a match is accepted, grey levels."""
FLOW_WINDOW = 9
"""Side of the window over which the optical flow left by a match is averaged, px.

At 15 px, a late ball 9 to 25 px wide that has moved 3.5 px keeps a depth on 21 % of its pixels, at 9 on none.
"""
SURFACE_PX = 1.0
"""Scatter of neighbours on one surface, standard deviation in px of disparity."""
SEARCH_PX = 5.0
"""Radius of surface smoothing, standard deviation in px; also half the window."""
WINDOW = 7
"""Side of the window over which the remaining shift is measured, px."""
MAX_SHIFT_PX = 0.5
WEAK_GRADIENT = 20.0
"""Squared brightness gradient ((grey levels)^2 per px^2) at which half of a shift is applied."""


def matching_bytes(width: float, height: float, disparities: float) -> float:
    """Return the memory for matching a rectified pair of this size."""
    return height * (width + disparities + 16) * BYTES_PER_PIXEL


def match_rectified(reference: Array, other: Array, low: int, count: int) -> Array:
    """Return the disparity (height x width, px, NaN = none) of a rectified pair, reference minus other.

    The search covers [low, low + count), count a multiple of 16. Cost paths run along the rows in both
    directions, and down. No cost volume is stored, and four threads share the rows.
    """
    if reference.shape[1] <= low + count:
        # Too narrow for the whole search range at any pixel: OpenCV would fail.
        return np.full(reference.shape, np.nan, np.float32)
    matcher = cv2.StereoSGBM.create(
        minDisparity=low,
        numDisparities=count,
        blockSize=BLOCK,
        P1=8 * BLOCK * BLOCK,
        P2=32 * BLOCK * BLOCK,
        disp12MaxDiff=-1,
        preFilterCap=15,
        uniquenessRatio=0,
        speckleWindowSize=0,
        speckleRange=0,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    raw = matcher.compute(reference, other).astype(np.float32) / 16
    return np.asarray(np.where(raw < low, np.nan, raw), np.float32)


def match_rectified_back(reference: Array, other: Array, low: int, count: int) -> Array:
    """Return the disparity on the other view's pixels, with cost paths that run up; see `match_rectified`.

    Each direction of paths propagates different errors: fewer pixels are wrong where both agree.
    """
    # The matcher leaves out the first low + count columns, so the image is padded by as many.
    first, second = (
        np.ascontiguousarray(np.pad(image, ((0, 0), (0, low + count)))[::-1, ::-1])
        for image in (other, reference)
    )
    return match_rectified(first, second, low, count)[::-1, : low + count - 1 : -1]


def warp_by_disparity(image: Array, disparity: Array, *, nearest: bool = False) -> Array:
    """Warp the other view's image (float32) onto the reference's canvas by the disparity."""
    xs, ys = np.meshgrid(*(np.arange(size, dtype=np.float32) for size in reversed(disparity.shape)))
    shifted = (xs - np.where(np.isnan(disparity), np.float32(1e6), disparity)).astype(np.float32)
    source = np.ascontiguousarray(image, np.float32)
    how = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
    return np.asarray(cv2.remap(source, shifted, ys, how, borderValue=(float("nan"),)))


def same_brightness(a: Array, b: Array) -> Array:
    """Return where two images (float32, grey levels) differ by no more than noise and half a pixel (bool).

    At an edge, half a pixel of the row changes the brightness by half its slope (Birchfield and Tomasi 1998).
    """
    beside = np.ones((1, 3), np.uint8)
    half_pixel = (cv2.dilate(a, beside) - cv2.erode(a, beside)) / 4
    return np.asarray(cv2.blur(np.abs(a - b) - half_pixel, (5, 5)) < MAX_GREY_DIFFERENCE + 3 * noise_level(a))


def residual_displacement(reference: Array, warped: Array) -> Array:
    """Return the displacement left between the reference and the warped image (both uint8), px.

    It is the mean optical flow around each pixel, weighted by the squared slope of the brightness in the
    flow's direction. Where no slope is above the noise, nothing shows a displacement, and it is near 0.
    """
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST).calc(reference, warped, None)
    window = (FLOW_WINDOW, FLOW_WINDOW)
    # Half the noise, as a slope: what flat surfaces show by chance.
    unseen = 0.25 * noise_level(reference) ** 2 + 1e-6
    means = []
    for direction in (0, 1):
        slope = cv2.Sobel(reference, cv2.CV_32F, 1 - direction, direction, ksize=5, scale=1 / 128)
        weight = slope * slope
        means.append(cv2.blur(weight * flow[..., direction], window) / (cv2.blur(weight, window) + unseen))
    return np.asarray(np.hypot(*means))


def window_correlation(a: Array, b: Array) -> Array:
    """Return the normalized correlation of two images (float32) over a window around each pixel."""
    size = (CHECK_WINDOW, CHECK_WINDOW)
    mean_a, mean_b = cv2.blur(a, size), cv2.blur(b, size)
    var_a = np.maximum(cv2.blur(a * a, size) - mean_a**2, 0)
    var_b = np.maximum(cv2.blur(b * b, size) - mean_b**2, 0)
    return np.asarray((cv2.blur(a * b, size) - mean_a * mean_b) / np.sqrt(np.maximum(var_a * var_b, 1e-3)))


def fill_small_holes(checked: Array, raw: Array) -> Array:
    """Accept rejected pixels beside accepted ones (0.3 of a 7 x 7 window) if they continue them."""
    good = np.isfinite(checked)
    weight = cv2.blur(good.astype(np.float32), (7, 7))
    mean = cv2.blur(np.where(good, checked, 0).astype(np.float32), (7, 7)) / np.maximum(weight, 1e-6)
    return np.where(~good & (weight > 0.3) & (np.abs(raw - mean) < 1.0), raw, checked)


def refine_disparity(reference: Array, other: Array, disparity: Array) -> Array:
    """Refine a disparity (float32 height x width, px, NaN = none); NaN stays NaN.

    The images are a rectified pair, in grey levels, equally bright.
    """
    smooth = _smooth_surfaces(disparity)
    return _smooth_surfaces(smooth + _left_shift(reference, other, smooth))


def _left_shift(reference: Array, other: Array, disparity: Array) -> Array:
    """Return the shift between the reference and the warped other image (Lucas and Kanade 1981), px."""
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
    # Far enough from all known values to have no weight.
    nothing = np.float32(-50.0 * SURFACE_PX)
    smooth = cv2.bilateralFilter(
        np.where(known, disparity, nothing), 2 * round(SEARCH_PX) + 1, SURFACE_PX, SEARCH_PX
    )
    return np.where(known, smooth, np.nan).astype(np.float32)
