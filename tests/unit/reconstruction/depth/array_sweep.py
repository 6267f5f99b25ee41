"""The sweep's kernels said once more with NumPy and OpenCV, for the tests of the compiled ones."""

import math
from collections.abc import Sequence
from itertools import product

import cv2
import numpy as np
import pytest

from reconstruction.common.geometry import Array
from reconstruction.depth import geometric_consistency, plane_sweep
from reconstruction.depth.calibrated_image import OUTSIDE, SourceView, box_filter
from reconstruction.depth.geometric_consistency import RELATIVE_DEPTH
from reconstruction.depth.plane_sweep import Surface
from reconstruction.depth.sweep_kernels import BETTER_OF_TWO, WORST_COST, Agreement
from reconstruction.methods.multiview.consistent_pixels import SUPPORT_PLACES, SUPPORT_PX
from reconstruction.methods.multiview.edge_sharpening import (
    FAR_PRIOR,
    GAIN_WEIGHT,
    MAX_COST,
    MIN_DIFFERENCE,
    MIN_JUMP,
    NEIGHBOURHOOD_PX,
    REACH_PX,
    _differences,
)

JUMP_GREY = 8
"""Grey-level difference between neighbouring pixels that halves the penalty of a jump."""
MIN_PRICE = 1.5
"""Minimum penalty of a jump, in units of the small step's."""


def cost_volume(source_views: Sequence[SourceView], base: Array | None, offsets: Array) -> Array:
    """Return costs (height x depths x width, uint8, 0 = equal) at inverse depths `base` plus `offsets`.

    `base` (height x width) None means planes facing the reference. Windows are compared by correlation.
    """
    height, width = source_views[0].reference.grey.shape
    base = np.zeros((height, width), np.float32) if base is None else base
    volume = np.empty((height, len(offsets), width), np.uint8)
    for number, offset in enumerate(offsets.astype(np.float32)):
        found = [correlate_windows(one, warp(one, base + offset)) for one in source_views]
        volume[:, number] = WORST_COST * (1 - np.minimum(combine_likeness(found), 1))
    return volume


def find_cheapest(volume: Array, grey: Array, small: int, large: int) -> tuple[Array, Array]:
    """Return index and cost of each pixel's cheapest depth in `volume`, after the semi-global scan."""
    return cheapest_depths(aggregate_costs(volume, grey, small, large), volume)


def warp(source_view: SourceView, inverse_depth: Array) -> Array:
    """Return the source's grey levels warped by inverse depths, `OUTSIDE` beyond its image."""
    x, y, _ = source_view.project(inverse_depth)
    grey = source_view.source.grey
    at = np.nan_to_num(x, nan=-1e4), np.nan_to_num(y, nan=-1e4)
    return np.asarray(cv2.remap(grey, *at, cv2.INTER_LINEAR, borderValue=(OUTSIDE,)))


def costs_along(source_views: Sequence[SourceView], inverse_depth: Array) -> Array:
    """Return the costs along one surface (height x width, uint8)."""
    return np.array(cost_volume(source_views, inverse_depth, np.zeros(1))[:, 0])


def sweep_by_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have sweeps and the comparison of their surfaces take these steps instead of the compiled ones."""
    for step in (cost_volume, costs_along, find_cheapest, fit_planes):
        monkeypatch.setattr(plane_sweep, step.__name__, step)
    monkeypatch.setattr(geometric_consistency, "compare_surfaces", compare_surfaces)


def fit_planes(
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
    planes = np.zeros((3, *inverse_depth.shape), np.float32)
    planes[0] = inverse_depth
    if slopes is not None:
        planes[1:] = slopes * np.float32(border)
    padded = np.pad(planes[0], border, constant_values=-1e6)
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


def compare_surfaces(
    inverse_depth: Array, source_view: SourceView, other: Array, agreement: Agreement
) -> tuple[Array, Array]:
    """Return where another view's surface agrees with this one, and where it could see it (bool)."""
    x, y, z = source_view.project(inverse_depth)
    x, y = np.nan_to_num(x, nan=-1e4), np.nan_to_num(y, nan=-1e4)
    seen = cv2.remap(other, x, y, cv2.INTER_NEAREST, borderValue=(0.0,))
    expected = inverse_depth / np.maximum(z, 1e-6)
    off = np.abs(seen - expected)
    inside = (seen > 0) & (z > 1e-6) & (cosine_of_rays(source_view, inverse_depth) > agreement.cosine)
    near = off * pixels_per_inverse_depth(source_view, x, y) < agreement.pixels
    same = (off < agreement.relative * seen) & ((off < agreement.sure * seen) | near)
    return inside & same, inside & (seen <= expected * (1 + agreement.relative))


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
    return np.asarray(np.maximum(price, np.float32(MIN_PRICE * small)).astype(np.int16))


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


def pixels_per_inverse_depth(source_view: SourceView, x: Array, y: Array) -> Array:
    """Return the motion in the reference, px, per unit of inverse depth of the source's pixel x, y."""
    back = -source_view.rotation.T @ source_view.translation
    inverse = np.linalg.inv(source_view.source.view.matrix)
    ray = np.stack([inverse[0, 0] * x + inverse[0, 2], inverse[1, 1] * y + inverse[1, 2]])
    rotation = source_view.rotation.T.astype(np.float32)
    direction = [rotation[i, 0] * ray[0] + rotation[i, 1] * ray[1] + rotation[i, 2] for i in range(3)]
    far = np.maximum(np.abs(direction[2]), 1e-3)
    moved = [back[i] - direction[i] / far * back[2] for i in range(2)]
    return np.asarray(source_view.reference.view.focal * np.hypot(*moved) / far, np.float32)


def cosine_of_rays(source_view: SourceView, inverse_depth: Array) -> Array:
    """Return the cosine of the angle between both views' rays at the reference's inverse depths."""
    rays = source_view.reference.rays
    to_source = (
        rays
        - (-source_view.rotation.T @ source_view.translation).astype(np.float32)[:, None, None]
        * inverse_depth
    )
    lengths = np.sqrt((rays * rays).sum(0) * (to_source * to_source).sum(0))
    return np.asarray((rays * to_source).sum(0) / np.maximum(lengths, 1e-9))


def splat_arrays(source_view: SourceView, depth: Array, nearest: Array) -> None:
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


def sharpen_by_arrays(surface: Surface, source_views: Sequence[SourceView], where: Array) -> Surface:
    """Sharpen edges as `sharpen_edges`."""
    level = surface.inverse_depth
    around, small = np.ones((2 * REACH_PX - 1,) * 2, np.uint8), np.ones((3, 3), np.uint8)
    jumps = where & (cv2.dilate(level, small) > (1 + MIN_JUMP) * cv2.erode(level, small))
    pixels = np.nonzero(cv2.dilate(jumps.astype(np.uint8), around))
    near, far = both_sides(surface, pixels)
    apart = (far[0] > 0) & (near > (1 + MIN_DIFFERENCE) * far[0])
    pixels = tuple(axis[apart] for axis in pixels)
    near, far = near[apart], far[:, apart]
    gain = np.zeros(level.shape, np.float32)
    flat = np.ravel_multi_index(pixels, level.shape)
    gain[pixels] = _differences(level, flat, near, source_views)
    gain[pixels] -= _differences(level, flat, far[0], source_views)
    nearer = (where & (surface.cost < MAX_COST))[pixels] & (2 * level[pixels] > near + far[0])
    pixels, between = tuple(axis[nearer] for axis in pixels), (near + far[0])[nearer] / 2
    farther, nearby, gained = sides_of(level, gain, source_views[0].reference.coloured, pixels, between)
    gained = gained + np.minimum(gain[pixels], 0)
    moved = np.log((farther + 0.05) / (nearby + 0.05)) + GAIN_WEIGHT * gained > -FAR_PRIOR
    found = np.stack(surface)
    found[:3, pixels[0][moved], pixels[1][moved]] = far[:, nearer][:, moved]
    return Surface(*found)


def both_sides(surface: Surface, pixels: tuple[Array, ...]) -> tuple[Array, Array]:
    """Return the nearest level (n,) and the farthest plane (3, n) around pixels, extended to these."""
    height, width = surface.inverse_depth.shape
    around = REACH_PX, REACH_PX
    planes = np.pad(surface[:3], ((0, 0), around, around), "edge")
    # Beyond the image its outermost planes go on.
    for axis, size in ((1, width), (2, height)):
        beyond = np.arange(-REACH_PX, size + REACH_PX, dtype=np.float32)
        beyond -= beyond.clip(0, size - 1)
        planes[0] += planes[axis] * (beyond if axis == 1 else beyond[:, None])
    wide = width + 2 * REACH_PX
    farthest = own = (pixels[0] + REACH_PX) * wide + pixels[1] + REACH_PX
    near = far = planes[0].take(own)
    for off in (REACH_PX, REACH_PX // 2):
        for dy, dx in product((-off, 0, off), repeat=2):
            at = own + (dy * wide + dx)
            level, slope_x, slope_y = (part.take(at) for part in planes)
            level -= slope_x * dx + slope_y * dy
            near = np.maximum(near, level)
            farthest = np.where(level < far, at, farthest)
            far = np.minimum(far, level)
    return near, np.stack([far, *(part.take(farthest) for part in planes[1:])])


def sides_of(
    level: Array, gain: Array, colours: Array, pixels: tuple[Array, ...], between: Array
) -> tuple[Array, Array, Array]:
    """Return the weights (n,) of pixels' neighbours on the farther and the nearer side, and the mean gain."""
    farther, nearer, gained, judged = (np.zeros(len(between)) for _ in range(4))
    reach = range(-NEIGHBOURHOOD_PX, NEIGHBOURHOOD_PX + 1, 2)
    for dy, dx in product(reach, repeat=2):
        rows, columns = pixels[0] + dy, pixels[1] + dx
        there = (rows >= 0) & (rows < level.shape[0]) & (columns >= 0) & (columns < level.shape[1])
        at = rows.clip(0, level.shape[0] - 1), columns.clip(0, level.shape[1] - 1)
        apart = np.abs(colours[at].astype(float) - colours[pixels]).mean(-1)
        weight = there * np.exp(-apart / 10 - math.hypot(dx, dy) / 6)
        far = level[at] < between
        farther += weight * far
        nearer += weight * ~far
        gained += weight * gain[at].clip(0)
        judged += weight * (gain[at] != 0)
    return farther, nearer, gained / np.maximum(judged, 1e-3)


def valid_fraction(valid: Array, surface: Surface, pixels: tuple[Array, ...]) -> Array:
    """Return the valid fraction of the surface around pixels at these rows and columns (n,).

    Pixels on other surfaces, such as the background beyond an edge, do not count.
    """
    radius = SUPPORT_PX // 2
    rows, columns = pixels
    level, slope_x, slope_y, _ = (part[pixels] for part in surface)
    # Beyond the image there is no surface.
    around = cv2.copyMakeBorder(
        surface.inverse_depth, radius, radius, radius, radius, cv2.BORDER_CONSTANT, value=(-1e6,)
    )
    beyond, wide = np.pad(valid, radius), around.shape[1]
    places, there = (np.zeros(len(rows), np.float32) for _ in range(2))
    for dy, dx in product(range(-radius, radius + 1, 2), repeat=2):
        at = (rows + (radius + dy)) * wide + (columns + (radius + dx))
        near = np.abs(around.take(at) - level - slope_x * dx - slope_y * dy) < RELATIVE_DEPTH * level
        places += near
        there += near & beyond.take(at)
    return np.asarray(there / np.maximum(places, SUPPORT_PLACES))
