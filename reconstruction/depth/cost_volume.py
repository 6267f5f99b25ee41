"""Matching costs of source windows against a reference at many depths, with OpenCV, in bands of rows.

A band's arrays stay in the processor's cache; a whole image's would go to memory and back at each step.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import OUTSIDE, SourceView, box_filter

WORST_COST = 255
"""Matching cost of zero correlation."""
BETTER_OF_TWO = 0.65
"""Weight of the better of two sources; beside a near object, one of them sees that object instead."""
BAND_PIXELS = 64_000


def cost_volume(source_views: Sequence[SourceView], base: Array | None, offsets: Array) -> Array:
    """Return costs (height x depths x width, uint8, 0 = equal) at inverse depths `base` plus `offsets`.

    `base` (height x width) None means planes facing the reference. Windows are compared by correlation.
    """
    reference = source_views[0].reference
    height, width = reference.view.height, reference.view.width
    volume = np.empty((height, len(offsets), width), np.uint8)
    margin = reference.window // 2
    rows = max(2 * reference.window, BAND_PIXELS // width)
    for top in range(0, height, rows):
        bottom = min(top + rows, height)
        low, high = max(top - margin, 0), min(bottom + margin, height)
        inner = slice(top - low, bottom - low)
        band = slice(low, high)
        for number, offset in enumerate(offsets):
            shown = (_warp(one, band, base, float(offset)) for one in source_views)
            found = [correlate_windows(one, w, band) for one, w in zip(source_views, shown, strict=True)]
            together = combine_likeness(found)[inner]
            np.minimum(together, 1.0, out=together)
            together *= -WORST_COST
            np.add(together, WORST_COST, out=volume[top:bottom, number], casting="unsafe")
    return volume


def combine_likeness(likeness: Sequence[Array]) -> Array:
    """Return the mean of the correlations (0 to 1) with several sources, in place of the first array.

    An object in front may hide a point from one source: of three or more the worst is left out, of two the
    better one counts more.
    """
    total = likeness[0]
    if len(likeness) == 1:
        return total
    worst = np.minimum(likeness[0], likeness[1])
    for one in likeness[2:]:
        np.minimum(worst, one, out=worst)
    for one in likeness[1:]:
        total += one
    if len(likeness) == 2:
        total *= BETTER_OF_TWO
        worst *= 1 - 2 * BETTER_OF_TWO
        total += worst
        return total
    total -= worst
    total *= 1 / (len(likeness) - 1)
    return total


def _warp(source_view: SourceView, rows: slice, base: Array | None, offset: float) -> Array:
    """Return the source's grey levels warped to these rows of the reference."""
    picture = source_view.source.grey
    if base is not None:
        x, y, _ = source_view.project(base[rows] + np.float32(offset), rows)
        np.nan_to_num(x, copy=False, nan=-1e4)
        return np.asarray(cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderValue=OUTSIDE))
    matrix = source_view.plane_warp(offset)
    matrix[:, 2] += rows.start * matrix[:, 1]
    size = source_view.reference.view.width, rows.stop - rows.start
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpPerspective(picture, matrix, size, flags=flags, borderValue=OUTSIDE))


def correlate_windows(source_view: SourceView, warped: Array, rows: slice = slice(None)) -> Array:
    """Return the windowed correlation (0 to 1, float32) of a source's warped grey levels and the reference.

    It is 0 outside the source. `rows` are the reference's rows that `warped` covers; `warped` is modified.
    """
    reference = source_view.reference
    window, own_mean = reference.window, reference.mean[rows]
    mean = box_filter(warped, window)
    both = box_filter(warped * reference.grey[rows], window)
    both -= mean * own_mean
    np.multiply(warped, warped, out=warped)
    deviation = box_filter(warped, window)
    deviation -= mean * mean
    np.maximum(deviation, 0.0, out=deviation)
    deviation += source_view.source.noise
    np.sqrt(deviation, out=deviation)
    deviation *= reference.deviation[rows]
    both /= deviation
    # A window that touches areas outside the source.
    both[mean < 0] = 0.0
    return np.asarray(np.maximum(both, 0.0, out=both))
