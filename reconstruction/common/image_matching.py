"""Matching of one image to another: brightness, noise, and points tracked there and back."""

import cv2
import numpy as np

from reconstruction.common.geometry import Array


def noise_level(image: Array) -> float:
    """Return the standard deviation of an image's noise, grey levels (Immerkaer 1996, with the median)."""
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    response = cv2.filter2D(np.ascontiguousarray(image, np.float32), -1, kernel)
    return float(np.median(np.abs(response))) * 1.4826 / 6.0


def match_brightness(a: Array, b: Array) -> Array:
    """Return b with gain and bias adjusted to the brightness of a (robust; NaN is left out)."""
    gain, bias = gain_and_bias(a, b)
    return np.asarray(gain * b + bias, np.float32)


def gain_and_bias(a: Array, b: Array) -> tuple[float, float]:
    """Return the gain and bias (robust) with which `gain * b + bias` has the brightness of a.

    Pixels that are NaN in b are left out.
    """
    x, y = (image[np.isfinite(b)][::7].astype(np.float64) for image in (b, a))
    keep = np.ones(len(x), bool)
    gain, bias = 1.0, 0.0
    for _ in range(3):
        if keep.sum() < 50 or np.ptp(x[keep]) < 4:
            break
        gain, bias = np.polyfit(x[keep], y[keep], 1)
        error = np.abs(gain * x + bias - y)
        keep = error < 3 * max(float(np.median(error)), 0.5)
    return float(np.clip(gain, 0.5, 2.0)), float(bias)


def gain_and_bias_of_shades(a: Array, b: Array) -> tuple[float, float]:
    """Return the gain and bias that match the distribution of b's grey levels to a's; both (n,).

    Both are of the same objects, in any order. Values need no partner, unlike in `gain_and_bias`, so that
    wrong matches hardly matter.
    """
    if a.size < 700:
        return 1.0, 0.0
    mine, target = (np.percentile(image[::7], (5, 25, 50, 75, 95)) for image in (b, a))
    if np.ptp(mine) < 4:
        return 1.0, 0.0
    gain = float(np.clip(np.polyfit(mine, target, 1)[0], 0.5, 2.0))
    return gain, float(np.mean(target - gain * mine))


def track_there_and_back(
    a: Array, b: Array, at: Array, window_px: int, levels: int = 3
) -> tuple[Array, Array]:
    """Track points (n, 2) from grey image a to b and back.

    Returns the points in b, and each one's distance from its start after returning, px (n,), infinite if
    tracking failed. The method is Lucas-Kanade, in a pyramid up to level `levels`.
    """
    start = at.astype(np.float32).reshape(-1, 1, 2)
    window = (window_px, window_px)
    there, is_tracked, _ = cv2.calcOpticalFlowPyrLK(a, b, start, None, winSize=window, maxLevel=levels)
    back, returned, _ = cv2.calcOpticalFlowPyrLK(b, a, there, None, winSize=window, maxLevel=levels)
    drift = np.linalg.norm(back - start, axis=2)
    return there.reshape(-1, 2), np.where((is_tracked > 0) & (returned > 0), drift, np.inf).ravel()
