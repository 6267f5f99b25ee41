"""Sweep operations with NumPy and OpenCV: the fallback engine, and the reference for other engines."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import OUTSIDE, SourceView
from reconstruction.depth.cost_volume import cost_volume
from reconstruction.depth.plane_fitting import fit_planes

BAND_CELLS = 12_000
"""Depths times rows that are transposed at once; they stay in the processor's cache."""
JUMP_GREY = 8
"""Grey-level difference between neighbouring pixels that halves the penalty of a jump."""
MIN_JUMP = 1.5
"""Minimum penalty of a jump, in units of the small step's."""


def aggregate_costs(costs: Array, grey: Array, small: int, large: int) -> Array:
    """Sum smoothed costs over 8 paths (Hirschmueller 2008), int16 height x depths x width.

    The input costs are uint8 of that shape.

    `small` is the penalty of a step by one depth, `large` of any larger step, reduced where `grey` (float32
    height x width) changes between pixels. Slanted paths continue along the image's border.
    """
    total = np.zeros(costs.shape, np.int16)
    for direction in (1, -1):
        _sweep(costs[::direction], total[::direction], grey[::direction], small, large, (0, 1, -1))
    # Paths along rows are independent: a band of rows at a time keeps the transposed copies small.
    rows = max(1, BAND_CELLS // costs.shape[1])
    for top in range(0, len(costs), rows):
        band = slice(top, top + rows)
        sideways = np.empty((costs.shape[2], costs.shape[1], len(costs[band])), np.uint8)
        for depth in range(costs.shape[1]):
            sideways[:, depth] = cv2.transpose(costs[band, depth])
        across = np.zeros(sideways.shape, np.int16)
        flipped = np.ascontiguousarray(grey[band].T)
        for direction in (1, -1):
            _sweep(sideways[::direction], across[::direction], flipped[::direction], small, large, (0,))
        for depth in range(costs.shape[1]):
            total[band, depth] += cv2.transpose(across[:, depth])
    return total


def _sweep(costs: Array, total: Array, grey: Array, small: int, large: int, shifts: tuple[int, ...]) -> None:
    """Add to `total` the smoothed costs along paths from the first row to the last.

    One set of paths for each of `shifts`, in columns per row. `small` and `large` as in `aggregate_costs`.
    """
    width = costs.shape[2]
    # The last column is repeated beyond the border.
    columns = [np.clip(np.arange(width) - shift, 0, width - 1) for shift in shifts]
    jumps = [_jump_prices(grey[1:], grey[:-1, column], small, large) for column in columns]
    before = [costs[0].astype(np.int16) for _ in shifts]
    for path in before:
        total[0] += path
    cheapest, last = np.empty_like(before[0]), np.empty_like(before[0])
    for row in range(1, len(costs)):
        cost = costs[row].astype(np.int16)
        for i, shift in enumerate(shifts):
            path = before[i]
            if shift > 0:
                last[:, 1:], last[:, 0] = path[:, :-1], path[:, 0]
            elif shift < 0:
                last[:, :-1], last[:, -1] = path[:, 1:], path[:, -1]
            else:
                path, last = last, path
            last -= last.min(0)
            np.minimum(last, jumps[i][row - 1], out=cheapest)
            last += np.int16(small)
            np.minimum(cheapest[1:], last[:-1], out=cheapest[1:])
            np.minimum(cheapest[:-1], last[1:], out=cheapest[:-1])
            cheapest += cost
            total[row] += cheapest
            before[i], cheapest = cheapest, path


def _jump_prices(here: Array, before: Array, small: int, large: int) -> Array:
    """Return the penalty of a jump between pixels of these grey levels (float32), int16."""
    price = np.float32(large) / (1 + np.abs(here - before) / np.float32(JUMP_GREY))
    return np.asarray(np.maximum(price, np.float32(MIN_JUMP * small)).astype(np.int16))


def cheapest_depths(total: Array, costs: Array) -> tuple[Array, Array]:
    """Return the index of each pixel's cheapest depth, refined by a parabola, and its unsmoothed cost.

    Both float32 height x width, from volumes of height x depths x width.
    """
    height, count, width = total.shape
    numbers = np.arange(count, dtype=np.int32)[:, None]
    columns = np.arange(width)
    place, own = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    for row in range(height):
        line = total[row].reshape(-1)
        # Cost and index in one integer: their minimum is far faster than argmin across rows.
        keyed = total[row].astype(np.int32)
        keyed <<= 9
        keyed |= numbers
        cheapest = keyed.min(0) & 511
        inner = np.clip(cheapest, 1, count - 2)
        at = inner * width + columns
        before, here, after = (line[at + k * width].astype(np.float32) for k in (-1, 0, 1))
        part = 0.5 * (before - after) / np.maximum(before - 2 * here + after, 1.0)
        place[row] = inner + np.clip(part, -0.5, 0.5)
        own[row] = costs[row].reshape(-1)[cheapest * width + columns]
    return place, own


class Agreement(NamedTuple):
    """Limits within which two views' surfaces agree."""

    relative: float
    """Maximum relative depth difference."""
    sure: float
    """Relative depth difference that always agrees, whatever its size in pixels at a wide angle."""
    pixels: float
    """Maximum distance after projection to the other view and back, otherwise."""
    cosine: float
    """Minimum cosine of the angle between two views; at larger angles they neither agree nor disagree."""


def compare_surfaces(
    inverse_depth: Array, source_view: SourceView, other: Array, agreement: Agreement
) -> tuple[Array, Array]:
    """Return where another view's surface agrees with this one, and where that view could see it (bool)."""
    x, y, z = source_view.project(inverse_depth)
    x, y = np.nan_to_num(x, nan=-1e4), np.nan_to_num(y, nan=-1e4)
    seen = cv2.remap(other, x, y, cv2.INTER_NEAREST, borderValue=(0.0,))
    expected = inverse_depth / np.maximum(z, 1e-6)
    off = np.abs(seen - expected)
    inside = (seen > 0) & (z > 1e-6)
    near = inside & (off < agreement.relative * seen)
    sure = off < agreement.sure * seen
    same = near & (sure | (off * source_view.pixels_per_inverse_depth(x, y) < agreement.pixels))
    able = inside & (seen <= expected * (1 + agreement.relative))
    small_angle = source_view.cosine(inverse_depth) > agreement.cosine
    return same & small_angle, able & small_angle


class SweepEngine:
    """Base engine of the sweep with NumPy and OpenCV; subclasses replace its methods."""

    def __init__(self, note: str = "") -> None:
        """Create an engine; `note`: the hardware that it runs on, and why; empty in the normal case."""
        self.note = note

    def cost_volume(self, source_views: Sequence[SourceView], base: Array | None, offsets: Array) -> Any:
        """Compute costs as `cost_volume`, in the engine's own layout and memory."""
        return cost_volume(source_views, base, offsets)

    aggregate = staticmethod(aggregate_costs)

    def find_cheapest(self, volume: Any, grey: Array, small: int, large: int) -> tuple[Array, Array]:
        """Return index and cost of each pixel's cheapest depth in `volume`, after the semi-global scan."""
        return cheapest_depths(aggregate_costs(volume, grey, small, large), volume)

    def costs_along(self, source_views: Sequence[SourceView], inverse_depth: Array) -> Array:
        """Return the costs along one surface (height x width, uint8)."""
        return np.ascontiguousarray(self.cost_volume(source_views, inverse_depth, np.zeros(1))[:, 0])

    def warp(self, source_view: SourceView, inverse_depth: Array) -> Array:
        """Return the source's grey levels warped by inverse depths, `OUTSIDE` beyond its image."""
        x, y, _ = source_view.project(inverse_depth)
        np.nan_to_num(x, copy=False, nan=-1e4)
        picture = source_view.source.grey
        return np.asarray(cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderValue=(OUTSIDE,)))

    fit_planes = staticmethod(fit_planes)
    compare = staticmethod(compare_surfaces)
