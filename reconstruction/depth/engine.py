"""What engines do for the sweep, by NumPy and OpenCV: the fallback, and what others are held against."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import OUTSIDE, SourceView
from reconstruction.depth.cost_volume import cost_volume
from reconstruction.depth.plane_fitting import fit_planes

BAND_CELLS = 12_000
"""Depths times rows of a column that are turned at once: they stay in the processor's cache."""
JUMP_GREY = 8
"""Grey levels from one pixel to the next that halve the price of a jump."""
MIN_JUMP = 1.5
"""Least price of a jump, in small steps."""


def aggregate_costs(costs: Array, grey: Array, small: int, large: int) -> Array:
    """Sum over 8 paths of the costs with smoothness (Hirschmueller 2008), int16 height x depths x width.

    The costs are uint8 of that shape.

    `small` is the price of a step by one depth, `large` of any other step, less where `grey` (float32
    height x width) changes from one pixel to the next. Paths that slant go on along the picture's border.
    """
    total = np.zeros(costs.shape, np.int16)
    for way in (1, -1):
        _sweep(costs[::way], total[::way], grey[::way], small, large, (0, 1, -1))
    # Paths along rows do not meet: a band of rows at a time keeps the turned copies small.
    rows = max(1, BAND_CELLS // costs.shape[1])
    for top in range(0, len(costs), rows):
        band = slice(top, top + rows)
        sideways = np.empty((costs.shape[2], costs.shape[1], len(costs[band])), np.uint8)
        for depth in range(costs.shape[1]):
            sideways[:, depth] = cv2.transpose(costs[band, depth])
        across = np.zeros(sideways.shape, np.int16)
        flipped = np.ascontiguousarray(grey[band].T)
        for way in (1, -1):
            _sweep(sideways[::way], across[::way], flipped[::way], small, large, (0,))
        for depth in range(costs.shape[1]):
            total[band, depth] += cv2.transpose(across[:, depth])
    return total


def _sweep(costs: Array, total: Array, grey: Array, small: int, large: int, shifts: tuple[int, ...]) -> None:
    """Add the paths from the first row to the last that move by each of `shifts` columns a row."""
    width = costs.shape[2]
    # Beside the border lies its own last column, again.
    columns = [np.clip(np.arange(width) - shift, 0, width - 1) for shift in shifts]
    jumps = [_jump_prices(grey[1:], grey[:-1, column], small, large) for column in columns]
    before = [costs[0].astype(np.int16) for _ in shifts]
    for path in before:
        total[0] += path
    least, last = np.empty_like(before[0]), np.empty_like(before[0])
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
            np.minimum(last, jumps[i][row - 1], out=least)
            last += np.int16(small)
            np.minimum(least[1:], last[:-1], out=least[1:])
            np.minimum(least[:-1], last[1:], out=least[:-1])
            least += cost
            total[row] += least
            before[i], least = least, path


def _jump_prices(here: Array, before: Array, small: int, large: int) -> Array:
    """The price of a jump between pixels of these grey levels (float32), int16."""
    price = np.float32(large) / (1 + np.abs(here - before) / np.float32(JUMP_GREY))
    return np.asarray(np.maximum(price, np.float32(MIN_JUMP * small)).astype(np.int16))


def cheapest_depths(total: Array, costs: Array) -> tuple[Array, Array]:
    """Number of each pixel's cheapest depth, between two by a parabola, and the cost that it has itself.

    Both float32 height x width, from volumes of height x depths x width.
    """
    height, count, width = total.shape
    numbers = np.arange(count, dtype=np.int32)[:, None]
    columns = np.arange(width)
    place, own = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    for row in range(height):
        line = total[row].reshape(-1)
        # Cost and number in one integer: the least of these is far quicker than argmin across rows.
        keyed = total[row].astype(np.int32)
        keyed <<= 9
        keyed |= numbers
        least = keyed.min(0) & 511
        inner = np.clip(least, 1, count - 2)
        at = inner * width + columns
        before, here, after = (line[at + k * width].astype(np.float32) for k in (-1, 0, 1))
        part = 0.5 * (before - after) / np.maximum(before - 2 * here + after, 1.0)
        place[row] = inner + np.clip(part, -0.5, 0.5)
        own[row] = costs[row].reshape(-1)[least * width + columns]
    return place, own


class Agreement(NamedTuple):
    """When two views' surfaces are the same."""

    relative: float
    """Greatest relative difference of depth."""
    sure: float
    """Relative difference of depth that is agreement, however many pixels it is at a wide angle."""
    pixels: float
    """Greatest distance after going to the other view and back, elsewhere."""
    cosine: float
    """Of the angle between the two views; those from directions further apart neither agree nor disagree."""


def compare_surfaces(
    inverse_depth: Array, source_view: SourceView, other: Array, agreement: Agreement
) -> tuple[Array, Array]:
    """Where another view's surface is the same as this one, and where that view could see this one (bool)."""
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
    alike = source_view.cosine(inverse_depth) > agreement.cosine
    return same & alike, able & alike


class SweepEngine:
    """The functions in which engines part, as NumPy and OpenCV do them; all else is one text."""

    def __init__(self, note: str = "") -> None:
        """`note`: what the sweep runs on and why; empty where that is nothing to speak of."""
        self.note = note

    def cost_volume(self, source_views: Sequence[SourceView], base: Array | None, offsets: Array) -> Any:
        """Costs as by `cost_volume`, in a form and a memory of the engine's own."""
        return cost_volume(source_views, base, offsets)

    aggregate = staticmethod(aggregate_costs)

    def find_cheapest(self, volume: Any, grey: Array, small: int, large: int) -> tuple[Array, Array]:
        """Place and cost of each pixel's cheapest depth of such costs, after the semi-global scan."""
        return cheapest_depths(aggregate_costs(volume, grey, small, large), volume)

    def costs_along(self, source_views: Sequence[SourceView], inverse_depth: Array) -> Array:
        """Costs along one surface (height x width, uint8)."""
        return np.ascontiguousarray(self.cost_volume(source_views, inverse_depth, np.zeros(1))[:, 0])

    def warp(self, source_view: SourceView, inverse_depth: Array) -> Array:
        """The source's grey levels seen through inverse depths, `OUTSIDE` where it does not reach."""
        x, y, _ = source_view.project(inverse_depth)
        np.nan_to_num(x, copy=False, nan=-1e4)
        picture = source_view.source.grey
        return np.asarray(cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderValue=(OUTSIDE,)))

    fit_planes = staticmethod(fit_planes)
    compare = staticmethod(compare_surfaces)
