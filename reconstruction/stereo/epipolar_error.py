"""How far matches lie from their epipolar line."""

import cv2
import numpy as np

from reconstruction.common.brightness import noise_level
from reconstruction.common.geometry import Array
from reconstruction.stereo.stereo_pair import StereoPair

MIN_PIXELS = 30
"""Fewer pixels than this are not measured."""
PATCH_PX = 21
PATCHES = 40
ROWS_PX = 28
"""How far from its row a patch is searched, px."""
LIKENESS = 0.75


def epipolar_errors(pair: StereoPair, reference: Array, other: Array, mask: Array) -> list[float]:
    """How far matched patches on a mask lie from their row, px of the rectified pictures.

    Patches of the reference (grey, uint8) are looked for freely in two dimensions; only sure finds count.
    """
    canvas = pair.rectification
    a, _ = canvas.remap(reference)
    b, seen = canvas.remap(other, other=True)
    on, _ = canvas.remap(mask.astype(np.uint8), nearest=True)
    half = PATCH_PX // 2
    ys, xs = np.nonzero(on)
    inside = (xs >= half) & (xs < a.shape[1] - half) & (ys >= half) & (ys < a.shape[0] - half)
    ys, xs = ys[inside], xs[inside]
    if len(ys) < MIN_PIXELS:
        return []
    least = 4 * noise_level(a) + 2
    errors = []
    for i in np.linspace(0, len(ys) - 1, PATCHES).astype(int):
        x, y = int(xs[i]), int(ys[i])
        patch = a[y - half : y + half + 1, x - half : x + half + 1]
        if patch.std() < least:
            continue
        left = max(0, x - pair.min_disparity - pair.num_disparities - half)
        right = min(b.shape[1], x - pair.min_disparity + half + 1)
        top, bottom = max(0, y - half - ROWS_PX), min(b.shape[0], y + half + 1 + ROWS_PX)
        strip = b[top:bottom, left:right]
        if min(strip.shape) < PATCH_PX or not seen[y, left:right].any():
            continue
        likeness = cv2.matchTemplate(strip, patch, cv2.TM_CCOEFF_NORMED)
        _, best, _, at = cv2.minMaxLoc(likeness)
        if best >= LIKENESS and 0 < at[1] < likeness.shape[0] - 1:
            errors.append(abs(at[1] + _peak(likeness[at[1] - 1 : at[1] + 2, at[0]]) + top + half - y))
    return errors


def _peak(values: Array) -> float:
    """Offset of a parabola's top from the middle of three values, in -0.5..0.5."""
    low, middle, high = (float(value) for value in values)
    bend = low - 2 * middle + high
    return 0.0 if bend >= 0 else float(np.clip(0.5 * (low - high) / bend, -0.5, 0.5))
