"""Cloud fused from all depth maps, and the test of its points against what other views measured."""

import ctypes
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.depth.kernels import call_kernel, floats
from reconstruction.methods.multiview.sweep_matcher import ViewDepth

SLACK = 0.005
"""Maximum relative depth difference of the same surface."""
BEHIND = -0.3
"""Maximum cosine between a point's normal and the direction to a view that sees it from behind."""


PosedMap = tuple[View, Array, Array, Array]
"""A view, its depth (float32, 0 = none), normals in its frame (float32) and picture (uint8 BGR)."""


class _Map(ctypes.Structure):
    _fields_ = (
        ("depth", ctypes.c_void_p),
        ("normals", ctypes.c_void_p),
        ("colours", ctypes.c_void_p),
        ("taken", ctypes.c_void_p),
        ("width", ctypes.c_int),
        ("height", ctypes.c_int),
        ("matrices", ctypes.c_float * 33),
    )

    @classmethod
    def of(cls, view: View, *arrays: Array) -> "_Map":
        """Return a view's map for the kernels, of its depth and what else they read or write of it."""
        matrix, rotation = view.matrix, view.rotation
        numbers = (
            *(matrix @ rotation, matrix @ view.translation),
            *(np.linalg.inv(matrix).T @ rotation, view.centre, rotation),
        )
        made = cls(*(array.ctypes.data for array in arrays))
        made.height, made.width = arrays[0].shape
        made.matrices = tuple(np.concatenate([part.ravel() for part in numbers]))
        return made


class FusedCloud(NamedTuple):
    """Surface points (n, 3) in the rig's frame and the views whose maps contain each, `seen` (n, views).

    `points` and unit `normals` are float32, `colours` uint8 RGB.
    """

    points: Array
    normals: Array
    colours: Array
    seen: Array


def fuse_maps(
    views: Mapping[str, View], depth_views: Mapping[str, ViewDepth], pictures: Mapping[str, Array], group: int
) -> FusedCloud:
    """Fuse maps into points that several of them contain, and that no other view denies (`find_denied`).

    As in COLMAP's fusion, each map in turn starts points at its pixels. A later map's pixel joins the first
    point that it shows with the same depth and normal. A point is the mean of its pixels.

    `pictures` (uint8 BGR) give the colours. `group`: size of the smallest group of cameras with a common
    view.
    """
    maps = [
        (view, depth_views[name].depth, depth_views[name].normals, pictures[name])
        for name, view in views.items()
        if name in depth_views
    ]
    # Limits as in COLMAP's fusion.
    fused, shown = fuse_posed_maps(maps, max(1, min(3, group)), 0.01, float(np.cos(np.radians(30))))
    seen = np.zeros((len(fused), len(views)), bool)
    seen[:, [name in depth_views for name in views]] = shown
    points, normals, colours = np.split(fused, 3, axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    accepted = ~find_denied(points, normals, views, depth_views)
    return FusedCloud(
        points[accepted], normals[accepted], np.rint(colours[accepted]).astype(np.uint8), seen[accepted]
    )


def fuse_posed_maps(
    maps: Sequence[PosedMap], required: int, error: float, cosine: float
) -> tuple[Array, Array]:
    """Return places, normals and colours of points (n, 9), and the maps (n, maps) that each is from."""
    arrays = [
        (floats(depth), floats(normals), np.ascontiguousarray(picture, np.uint8), np.zeros(depth.shape, bool))
        for _, depth, normals, picture in maps
    ]
    for depth, normals, picture, _ in arrays:
        if not (*depth.shape, 3) == normals.shape == picture.shape:
            raise ValueError(f"a depth map of {depth.shape} has normals or a picture of another size")
    given = [_Map.of(view, *parts) for (view, *_), parts in zip(maps, arrays, strict=True)]
    max_views = sum(depth.size for depth, *_ in arrays) // required + 1
    points, seen = np.empty((max_views, 9), np.float32), np.empty((max_views, len(maps)), bool)
    number = ctypes.c_int64()
    call_kernel(
        "fuse",
        *(len(maps), (_Map * len(maps))(*given), required, ctypes.c_float(error), ctypes.c_float(cosine)),
        *(points, seen, ctypes.byref(number)),
    )
    return points[: number.value], seen[: number.value]


def surface_points(view: View, rows: Array, columns: Array, depth: Array) -> Array:
    """Return points (n, 3), float32, in the rig's frame, of pixels at these depths."""
    back = (np.linalg.inv(view.matrix).T @ view.rotation).astype(np.float32)
    pixels = np.column_stack([columns, rows, np.ones(len(rows))]).astype(np.float32)
    return np.asarray((pixels @ back) * depth.astype(np.float32)[:, None] + view.centre.astype(np.float32))


def median_of_known(values: Array) -> Array:
    """Return the median along the first axis of the values that are not NaN; NaN if there are none."""
    # NaN is sorted last.
    ordered = np.sort(values, axis=0)
    count = np.isfinite(ordered).sum(0)
    middle = np.maximum([(count - 1) // 2, count // 2], 0)
    return np.asarray(np.take_along_axis(ordered, middle, 0).mean(0))


def find_denied(
    points: Array, normals: Array, views: Mapping[str, View], depth_views: Mapping[str, ViewDepth]
) -> Array:
    """Return which surface points (n, 3) views deny (bool), unless over twice as many others confirm them.

    A view confirms a point that faces it if it measured that depth. It denies a point if it clearly measured
    something farther, through the point. It also denies a point that is turned away from it if it measured
    nothing in front of it, as solid objects are not seen from behind.
    """
    points, normals, denied = floats(points), floats(normals), np.empty(len(points), bool)
    maps = [(views[name], floats(depth_view.depth)) for name, depth_view in depth_views.items()]
    call_kernel(
        "deny",
        *(len(maps), (_Map * len(maps))(*(_Map.of(*view_and_depth) for view_and_depth in maps))),
        *(ctypes.c_int64(len(points)), points, normals),
        *(ctypes.c_float(SLACK), ctypes.c_float(BEHIND), denied),
    )
    return denied


def project_points(view: View, points: Array) -> tuple[Array, Array, Array]:
    """Return the pixels of points (flat indices, 0 outside the image), their depth, and which are inside."""
    onto = (view.matrix @ view.rotation).astype(np.float32)
    shift = (view.matrix @ view.translation).astype(np.float32)
    x, y, z = onto @ points.T.astype(np.float32) + shift[:, None]
    ahead = z > 1e-6
    far = 1 / np.where(ahead, z, 1)
    columns, rows = np.rint(x * far), np.rint(y * far)
    inside = ahead & (columns >= 0) & (columns < view.width) & (rows >= 0) & (rows < view.height)
    rows, columns = (np.where(inside, axis, 0).astype(np.intp) for axis in (rows, columns))
    return rows * view.width + columns, z, inside
