"""Which disparities of a pair are kept: where both views look alike."""

from dataclasses import dataclass

import cv2
import numpy as np

from reconstruction.common.brightness import noise_level
from reconstruction.common.geometry import Array

CHECK_WINDOW = 9
"""Side of the window in which the two views must look alike, px."""


@dataclass(frozen=True)
class MatchChecks:
    """When a match is believed.

    `agreement_px`: left-right difference of disparity. `alike`: least normalized correlation of the two
    views in a window, asked for where there is texture. `grey`: greatest mean grey-level difference (of
    255) beside the noise. `residual_px`: greatest displacement that is left after the disparity is
    taken out; a true match leaves none, also not between rows.
    """

    agreement_px: float = 1.0
    alike: float = 0.0
    grey: float = 10.0
    residual_px: float = 0.7
    speckle_px: int = 60


def looks_alike(a: Array, b: Array, checks: MatchChecks) -> Array:
    """Where two images (float32, grey levels) show the same thing: correlation and brightness."""
    size = (CHECK_WINDOW, CHECK_WINDOW)
    mean_a, mean_b = cv2.blur(a, size), cv2.blur(b, size)
    var_a = np.maximum(cv2.blur(a * a, size) - mean_a**2, 0)
    var_b = np.maximum(cv2.blur(b * b, size) - mean_b**2, 0)
    both = cv2.blur(a * b, size) - mean_a * mean_b
    correlation = both / np.sqrt(np.maximum(var_a * var_b, 1e-3))
    noise = noise_level(a)
    flat = np.minimum(var_a, var_b) < (3 * noise) ** 2
    near = cv2.blur(np.abs(a - b), (3, 3)) < checks.grey + 3 * noise
    return np.asarray(near & (flat | (correlation > checks.alike)))


def fill_small_holes(checked: Array, raw: Array) -> Array:
    """Unbelieved pixels beside believed ones (0.3 of a 7 x 7 window) are believed if they continue them."""
    good = np.isfinite(checked)
    value = np.where(good, checked, 0).astype(np.float32)
    weight = cv2.blur(good.astype(np.float32), (7, 7))
    mean = cv2.blur(value, (7, 7)) / np.maximum(weight, 1e-6)
    fits = ~good & (weight > 0.3) & (np.abs(raw - mean) < 1.0)
    return np.where(fits, raw, checked)
