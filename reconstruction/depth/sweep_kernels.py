"""The compiled steps of the sweep: matching costs, semi-global scan, planes, and comparison of surfaces.

Arrays are read row by row, and results are equal on all machines.
"""

import ctypes
import threading
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import SourceView
from reconstruction.depth.kernels import call_kernel, floats

WORST_COST = 255
"""Matching cost of zero correlation."""
BETTER_OF_TWO = 0.65
"""Weight of the better of two sources; beside a near object, one of them sees that object instead."""


class KernelSource(ctypes.Structure):
    """A source view as the kernels take it; its image must stay in memory."""

    _fields_ = (
        ("pixels", ctypes.c_void_p),
        ("width", ctypes.c_int),
        ("height", ctypes.c_int),
        ("to", ctypes.c_float * 13),
    )


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


_memory = threading.local()


def cost_volume(source_views: Sequence[SourceView], base: Array | None, offsets: Array) -> Array:
    """Return costs (height x depths x width, uint8, 0 = equal) at inverse depths `base` plus `offsets`.

    `base` (height x width) None means planes facing the reference. Windows are compared by normalized
    correlation. Of three or more sources the worst is left out, as an object in front may hide a point
    from it; of two the better one counts more. The costs are valid until the thread's next call.
    """
    reference = source_views[0].reference
    height, width = reference.grey.shape
    volume = _reused("volume", (height, len(offsets), width), np.uint8)
    borders = [view.source.bordered for view in source_views]
    sources = (KernelSource * len(source_views))(*map(source_of, source_views, borders))
    call_kernel(
        "costs",
        *(height, width, len(offsets), reference.window // 2, len(sources)),
        *map(floats, (reference.grey, reference.mean, reference.deviation)),
        None if base is None else floats(base),
        floats(offsets),
        sources,
        ctypes.c_float(BETTER_OF_TWO),
        volume,
    )
    return volume


def warp(source_view: SourceView, inverse_depth: Array) -> Array:
    """Return the source's grey levels warped by inverse depths, `OUTSIDE` beyond its image."""
    out = np.empty(inverse_depth.shape, np.float32)
    bordered = source_view.source.bordered
    source = source_of(source_view, bordered)
    call_kernel("warp", *out.shape, floats(inverse_depth), ctypes.byref(source), out)
    return out


def find_cheapest(volume: Array, grey: Array, small: int, large: int) -> tuple[Array, Array]:
    """Return the index of each pixel's cheapest depth after the scan, and its unsmoothed cost.

    Both are float32 height x width; a parabola refines the index. See `aggregate_costs` for the rest.
    """
    place, own = (np.empty(grey.shape, np.float32) for _ in range(2))
    _scan(volume, grey, small, large, place, own)
    return place, own


def aggregate_costs(costs: Array, grey: Array, small: int, large: int) -> Array:
    """Sum smoothed costs over 8 paths (Hirschmueller 2008), int16 height x depths x width.

    The input costs are uint8 of that shape. `small` is the penalty of a step by one depth, `large` of any
    larger step, reduced where `grey` (float32 height x width) changes between pixels. Slanted paths
    continue along the image's border. The sums are valid until the thread's next scan.
    """
    return _scan(costs, grey, small, large, None, None)


def costs_along(source_views: Sequence[SourceView], inverse_depth: Array) -> Array:
    """Return the costs along one surface (height x width, uint8)."""
    return np.array(cost_volume(source_views, inverse_depth, np.zeros(1))[:, 0])


def _scan(volume: Array, grey: Array, small: int, large: int, *given: Array | None) -> Array:
    height, depths, width = volume.shape
    total = _reused("total", volume.shape, np.int16)
    call_kernel("cheapest", height, width, depths, volume, floats(grey), small, large, total, *given)
    return total


def _reused(name: str, shape: tuple[int, ...], dtype: type) -> Array:
    """Return an array in memory that this thread uses again; fresh pages take a tenth of a map's time."""
    arrays, count = vars(_memory), int(np.prod(shape))
    if name not in arrays or arrays[name].size < count:
        arrays[name] = np.empty(count, dtype)
    return np.asarray(arrays[name][:count].reshape(shape))


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
    # Beyond the image there is no plane.
    # `planes` processes 16 columns at once, and reads as many beyond the border.
    around = border, border, border, border + 16
    padded = cv2.copyMakeBorder(planes[0], *around, cv2.BORDER_CONSTANT, value=(-1e6,))
    call_kernel(
        "planes",
        *(*inverse_depth.shape, radius, stride, rounds),
        *(ctypes.c_float(tolerance), padded, planes),
    )
    planes[1:] /= np.float32(border)
    return planes


def compare_surfaces(
    inverse_depth: Array, source_view: SourceView, other: Array, agreement: Agreement
) -> tuple[Array, Array]:
    """Return where another view's surface agrees with this one, and where it could see it (bool)."""
    same, able = (np.empty(inverse_depth.shape, bool) for _ in range(2))
    rays = [np.linalg.inv(view.view.matrix) for view in (source_view.source, source_view.reference)]
    rotation = source_view.rotation.T
    pair = np.concatenate(
        [
            source_view.numbers,
            rotation.reshape(-1),
            -rotation @ source_view.translation,
            *(inverse[row, [row, 2]] for inverse in rays for row in (0, 1)),
            [source_view.reference.view.focal, *agreement],
        ]
    )
    bordered = cv2.copyMakeBorder(floats(other), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=(0.0,))
    call_kernel(
        "votes",
        *(*inverse_depth.shape, floats(inverse_depth)),
        *(*other.shape, bordered),
        *(floats(pair), same, able),
    )
    return same, able


def source_of(source_view: SourceView, bordered: Array) -> KernelSource:
    """Return the kernels' view of a source; the caller holds its bordered grey levels meanwhile."""
    view, numbers = source_view.source.view, (ctypes.c_float * 13)(*source_view.numbers)
    return KernelSource(bordered.ctypes.data, view.width, view.height, numbers)
