"""Disparities of a rectified pair by OpenCV's semi-global block matching (SGBM)."""

import cv2
import numpy as np

from reconstruction.common.geometry import Array

BLOCK = 5
"""Side of the matched window, px."""


def match_rectified(reference: Array, other: Array, low: int, count: int) -> Array:
    """Disparity (height x width, px, NaN = none) of a rectified pair; reference minus other, in
    [low, low + count), count a multiple of 16."""
    matcher = cv2.StereoSGBM.create(
        minDisparity=low,
        numDisparities=count,
        blockSize=BLOCK,
        P1=8 * BLOCK * BLOCK,
        P2=32 * BLOCK * BLOCK,
        disp12MaxDiff=-1,
        preFilterCap=31,
        uniquenessRatio=0,
        speckleWindowSize=0,
        speckleRange=0,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )
    raw = matcher.compute(reference, other).astype(np.float32) / 16
    return np.asarray(np.where(raw < low, np.nan, raw), np.float32)


def match_rectified_back(reference: Array, other: Array, low: int, count: int) -> Array:
    """Disparity as in `match_rectified`, but on the other view's pixels."""
    # The matcher leaves out the first low + count columns: give it so many more of them.
    first, second = (
        np.ascontiguousarray(np.pad(image, ((0, 0), (0, low + count)))[:, ::-1])
        for image in (other, reference)
    )
    return match_rectified(first, second, low, count)[:, : low + count - 1 : -1]


def warp_by_disparity(image: Array, disparity: Array) -> Array:
    """The other view's image (float32) seen through the disparity, on the reference's canvas."""
    xs, ys = np.meshgrid(
        np.arange(disparity.shape[1], dtype=np.float32), np.arange(disparity.shape[0], dtype=np.float32)
    )
    shifted = (xs - np.nan_to_num(disparity, nan=1e6)).astype(np.float32)
    seen = cv2.remap(
        np.ascontiguousarray(image, np.float32),
        shifted,
        ys,
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(float("nan"),),
    )
    return np.asarray(seen)
