"""Checks of a pair's disparities: they are kept where both views look the same."""

from dataclasses import dataclass

import cv2
import numpy as np

from reconstruction.common.brightness import noise_level
from reconstruction.common.geometry import Array

CHECK_WINDOW = 9
"""Side of the window in which the two views are correlated, px."""


@dataclass(frozen=True)
class MatchChecks:
    """Limits within which a match is accepted."""

    max_left_right_px: float = 1.0
    """Difference between the disparities of both directions."""
    min_correlation: float = 0.0
    """Normalized correlation of the two views in a window, asked for where there is texture."""
    max_grey_difference: float = 10.0
    """Mean difference of brightness beside the noise, grey levels of 255."""
    max_residual_px: float = 0.7
    """Displacement that is left after the disparity is taken out, also between rows: 0 for a true match."""
    min_island_px: int = 60
    """Smaller islands of depth are dropped."""


def same_appearance(a: Array, b: Array, checks: MatchChecks) -> Array:
    """Where two images (float32, grey levels) look the same, by correlation and brightness (bool)."""
    size = (CHECK_WINDOW, CHECK_WINDOW)
    mean_a, mean_b = cv2.blur(a, size), cv2.blur(b, size)
    var_a = np.maximum(cv2.blur(a * a, size) - mean_a**2, 0)
    var_b = np.maximum(cv2.blur(b * b, size) - mean_b**2, 0)
    both = cv2.blur(a * b, size) - mean_a * mean_b
    correlation = both / np.sqrt(np.maximum(var_a * var_b, 1e-3))
    noise = noise_level(a)
    flat = np.minimum(var_a, var_b) < (3 * noise) ** 2
    near = cv2.blur(np.abs(a - b), (3, 3)) < checks.max_grey_difference + 3 * noise
    return np.asarray(near & (flat | (correlation > checks.min_correlation)))


def fill_small_holes(checked: Array, raw: Array) -> Array:
    """Accept rejected pixels beside accepted ones (0.3 of a 7 x 7 window) where they continue them."""
    good = np.isfinite(checked)
    value = np.where(good, checked, 0).astype(np.float32)
    weight = cv2.blur(good.astype(np.float32), (7, 7))
    mean = cv2.blur(value, (7, 7)) / np.maximum(weight, 1e-6)
    fits = ~good & (weight > 0.3) & (np.abs(raw - mean) < 1.0)
    return np.where(fits, raw, checked)
