"""Sweep operations with NumPy and OpenCV: the fallback engine, and the reference for other engines."""

from collections.abc import Sequence
from itertools import product
from typing import Any, NamedTuple

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import OUTSIDE, SourceView, box_filter

WORST_COST = 255
"""Matching cost of zero correlation."""
BETTER_OF_TWO = 0.65
"""Weight of the better of two sources; beside a near object, one of them sees that object instead."""
JUMP_GREY = 8
"""Grey-level difference between neighbouring pixels that halves the penalty of a jump."""
MIN_JUMP = 1.5
"""Minimum penalty of a jump, in units of the small step's."""


def combine_likeness(likeness: Sequence[Array]) -> Array:
    """Return the mean of the correlations (0 to 1) with several sources.

    An object in front may hide a point from one source: of three or more the worst is left out, of two the
    better one counts more.
    """
    if len(likeness) == 1:
        return likeness[0]
    total, worst = np.sum(likeness, axis=0), np.min(likeness, axis=0)
    if len(likeness) == 2:
        return np.asarray(BETTER_OF_TWO * total + (1 - 2 * BETTER_OF_TWO) * worst)
    return np.asarray((total - worst) / (len(likeness) - 1))


def correlate_windows(source_view: SourceView, warped: Array) -> Array:
    """Return the windowed correlation (0 to 1, float32) of a source's warped grey levels and the reference.

    It is 0 outside the source.
    """
    reference, window = source_view.reference, source_view.reference.window
    mean = box_filter(warped, window)
    both = box_filter(warped * reference.grey, window) - mean * reference.mean
    variance = np.maximum(box_filter(warped * warped, window) - mean * mean, 0)
    both /= np.sqrt(variance + source_view.source.noise) * reference.deviation
    # A window that touches areas outside the source.
    return np.where(mean < 0, 0, np.maximum(both, 0)).astype(np.float32)


def aggregate_costs(costs: Array, grey: Array, small: int, large: int) -> Array:
    """Sum smoothed costs over 8 paths (Hirschmueller 2008), int16 height x depths x width.

    The input costs are uint8 of that shape.

    `small` is the penalty of a step by one depth, `large` of any larger step, reduced where `grey` (float32
    height x width) changes between pixels. Slanted paths continue along the image's border.
    """
    sideways = np.ascontiguousarray(costs.T)
    total, across = np.zeros(costs.shape, np.int16), np.zeros(sideways.shape, np.int16)
    for turn in (1, -1):
        _sweep(costs[::turn], total[::turn], grey[::turn], small, large, (0, 1, -1))
        _sweep(sideways[::turn], across[::turn], grey.T[::turn], small, large, (0,))
    return np.asarray(total + across.T)


def _sweep(costs: Array, total: Array, grey: Array, small: int, large: int, shifts: tuple[int, ...]) -> None:
    """Add to `total` the smoothed costs along paths from the first row to the last.

    One set of paths for each of `shifts`, in columns per row. `small` and `large` as in `aggregate_costs`.
    """
    total[0] += np.int16(len(shifts)) * costs[0]
    for shift in shifts:
        # The last column is repeated beyond the border.
        column = np.clip(np.arange(grey.shape[1]) - shift, 0, grey.shape[1] - 1)
        jumps = _jump_prices(grey[1:], grey[:-1, column], small, large)
        path = costs[0].astype(np.int16)
        for row, jump in enumerate(jumps, 1):
            last = path.take(column, axis=1)
            last -= last.min(0)
            path = np.minimum(last, jump)
            last += np.int16(small)
            np.minimum(path[1:], last[:-1], out=path[1:])
            np.minimum(path[:-1], last[1:], out=path[:-1])
            path += costs[row]
            total[row] += path


def _jump_prices(here: Array, before: Array, small: int, large: int) -> Array:
    """Return the penalty of a jump between pixels of these grey levels (float32), int16."""
    price = np.float32(large) / (1 + np.abs(here - before) / np.float32(JUMP_GREY))
    return np.asarray(np.maximum(price, np.float32(MIN_JUMP * small)).astype(np.int16))


def cheapest_depths(total: Array, costs: Array) -> tuple[Array, Array]:
    """Return the index of each pixel's cheapest depth, refined by a parabola, and its unsmoothed cost.

    Both float32 height x width, from volumes of height x depths x width.
    """
    cheapest = total.argmin(1)[:, None]
    inner = np.clip(cheapest, 1, total.shape[1] - 2)
    before, here, after = (np.take_along_axis(total, inner + k, 1).astype(np.float32) for k in (-1, 0, 1))
    part = 0.5 * (before - after) / np.maximum(before - 2 * here + after, 1.0)
    places = inner + np.clip(part, -0.5, 0.5), np.take_along_axis(costs, cheapest, 1)
    return places[0][:, 0].astype(np.float32), places[1][:, 0].astype(np.float32)


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


class SweepEngine:
    """Base engine of the sweep with NumPy and OpenCV; subclasses replace its methods."""

    def __init__(self, note: str = "") -> None:
        """Create an engine; `note`: the hardware that it runs on, and why; empty in the normal case."""
        self.note = note

    def cost_volume(self, source_views: Sequence[SourceView], base: Array | None, offsets: Array) -> Any:
        """Return costs (height x depths x width, uint8, 0 = equal) at inverse depths `base` plus `offsets`.

        `base` (height x width) None means planes facing the reference. Windows are compared by correlation.
        An engine may use a layout and memory of its own.
        """
        height, width = source_views[0].reference.grey.shape
        base = np.zeros((height, width), np.float32) if base is None else base
        volume = np.empty((height, len(offsets), width), np.uint8)
        for number, offset in enumerate(offsets.astype(np.float32)):
            found = [correlate_windows(one, self.warp(one, base + offset)) for one in source_views]
            volume[:, number] = WORST_COST * (1 - np.minimum(combine_likeness(found), 1))
        return volume

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
        grey = source_view.source.grey
        at = np.nan_to_num(x, nan=-1e4), np.nan_to_num(y, nan=-1e4)
        return np.asarray(cv2.remap(grey, *at, cv2.INTER_LINEAR, borderValue=(OUTSIDE,)))

    def splat(self, source_view: SourceView, depth: Array, nearest: Array) -> None:
        """Raise `nearest` to the inverse depths of the reference's surface at the source's pixels.

        `depth` (0 = none) is the reference's, `nearest` of the source's size.
        """
        there = depth > 0
        inverse = np.where(there, 1 / np.maximum(depth, 1e-12), 0).astype(np.float32)
        x, y, z = source_view.project(inverse)
        height, width = nearest.shape
        column, row = (np.rint(np.nan_to_num(axis, nan=-1)) for axis in (x, y))
        inside = there & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        at = row[inside].astype(np.int64), column[inside].astype(np.int64)
        np.maximum.at(nearest, at, inverse[inside] / z[inside])

    def fit_planes(
        self,
        inverse_depth: Array,
        tolerance: float,
        *,
        slopes: Array | None = None,
        radius: int = 2,
        stride: int = 1,
        rounds: int = 2,
    ) -> Array:
        """Fit a plane at each pixel: inverse depth and its slope per pixel in x and y (3 x height x width).

        A plane of the scene is linear in inverse depth over the pixels. The result is float32. The fit is by
        least squares to the neighbours within `radius * stride` px that are within `tolerance` of the
        previous plane, so that no plane bridges a depth edge. The first plane goes through the pixel's own
        depth and has these `slopes` (2 x height x width), or none.
        """
        border = radius * stride
        padded, planes = pad_planes(inverse_depth, slopes, border)
        height, width = inverse_depth.shape
        for _ in range(rounds):
            sums = np.zeros((9, height, width), np.float32)
            for dy, dx in product(range(-border, border + 1, stride), repeat=2):
                x, y = dx / border, dy / border
                gap = padded[border + dy :, border + dx :][:height, :width] - planes[0]
                weight = np.maximum(1 - ((gap - x * planes[1] - y * planes[2]) / tolerance) ** 2, 0)
                factors = np.array([1, x, y, x * x, x * y, y * y], np.float32)
                sums[:6] += np.multiply.outer(factors, weight)
                sums[6:] += np.multiply.outer(factors[:3], weight * gap)
            planes = _solve(sums, planes)
        planes[1:] /= np.float32(border)
        return planes

    def compare(
        self, inverse_depth: Array, source_view: SourceView, other: Array, agreement: Agreement
    ) -> tuple[Array, Array]:
        """Return where another view's surface agrees with this one, and where it could see it (bool)."""
        x, y, z = source_view.project(inverse_depth)
        x, y = np.nan_to_num(x, nan=-1e4), np.nan_to_num(y, nan=-1e4)
        seen = cv2.remap(other, x, y, cv2.INTER_NEAREST, borderValue=(0.0,))
        expected = inverse_depth / np.maximum(z, 1e-6)
        off = np.abs(seen - expected)
        inside = (seen > 0) & (z > 1e-6) & (source_view.cosine(inverse_depth) > agreement.cosine)
        near = off * source_view.pixels_per_inverse_depth(x, y) < agreement.pixels
        same = (off < agreement.relative * seen) & ((off < agreement.sure * seen) | near)
        return inside & same, inside & (seen <= expected * (1 + agreement.relative))


def pad_planes(
    inverse_depth: Array, slopes: Array | None, border: int, beyond: int = 0
) -> tuple[Array, Array]:
    """Return inverse depth with a border, wider by `beyond` on the right, and the first planes per border."""
    planes = np.zeros((3, *inverse_depth.shape), np.float32)
    planes[0] = inverse_depth
    if slopes is not None:
        planes[1:] = slopes * np.float32(border)
    # Beyond the image there is no plane.
    around = border, border, border, border + beyond
    return np.asarray(cv2.copyMakeBorder(planes[0], *around, cv2.BORDER_CONSTANT, value=(-1e6,))), planes


def _solve(sums: Array, before: Array) -> Array:
    """Solve the normal equations for planes; if underdetermined, return the previous planes.

    The sums, over the neighbours' positions and their gaps to the plane's level, are: n, x, y, xx, xy, yy,
    gap, x gap, y gap.
    """
    n = np.maximum(sums[0], 1e-6)
    mx, my, xx, xy, yy, mv, xv, yv = sums[1:] / n
    # Regularize slightly: along a depth edge the slope across it is unknown, and assumed flat.
    cxx, cxy, cyy = xx - mx * mx + 0.01, xy - mx * my, yy - my * my + 0.01
    cxv, cyv = xv - mx * mv, yv - my * mv
    det = np.maximum(cxx * cyy - cxy * cxy, 1e-6)
    slope_x, slope_y = (cyy * cxv - cxy * cyv) / det, (cxx * cyv - cxy * cxv) / det
    level = before[0] + mv - slope_x * mx - slope_y * my
    return np.where(n > 3.0, np.stack([level, slope_x, slope_y]), before)
