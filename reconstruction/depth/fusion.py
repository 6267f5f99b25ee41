"""Cloud fused from all depth maps, and the test of its points against what other views measured."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.depth.compiled import CPU, CompiledEngine, PosedMap
from reconstruction.depth.sweep_matcher import ViewDepth

MIN_VIEWS = 3
"""Minimum maps that contain a point, or all maps if there are fewer; limits as in COLMAP's fusion."""
MIN_NORMAL_COSINE = float(np.cos(np.radians(30)))
MAX_DEPTH_ERROR = 0.01
SLACK = 0.005
"""Maximum relative depth difference of the same surface."""
BEHIND = -0.3
"""Maximum cosine between a point's normal and the direction to a view that sees it from behind."""


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
    having = [name in depth_views for name in views]
    maps = [
        (view, depth_views[name].depth, depth_views[name].normals, pictures[name])
        for name, view in views.items()
        if name in depth_views
    ]
    limits = max(1, min(MIN_VIEWS, group)), MAX_DEPTH_ERROR, MIN_NORMAL_COSINE
    fused, shown = (CPU.fuse if isinstance(CPU, CompiledEngine) else fuse_arrays)(maps, *limits)
    seen = np.zeros((len(fused), len(views)), bool)
    seen[:, having] = shown
    points, normals, colours = np.split(fused, 3, axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    accepted = ~find_denied(points, normals, views, depth_views)
    return FusedCloud(
        points[accepted], normals[accepted], np.rint(colours[accepted]).astype(np.uint8), seen[accepted]
    )


def fuse_arrays(maps: Sequence[PosedMap], required: int, error: float, cosine: float) -> tuple[Array, Array]:
    """Fuse as `CompiledEngine.fuse`, except for rounding, where no library was built."""
    free = [depth.ravel() > 0 for _, depth, _, _ in maps]
    measured = [_measurements(*one) for one in maps]
    parts = []
    # A later map cannot be in enough others.
    for place in range(max(1, len(maps) + 1 - required)):
        first = measured[place][free[place]]
        total, seen = first.copy(), np.zeros((len(first), len(maps)), bool)
        seen[:, place] = True
        for later in range(place + 1, len(maps)):
            at, z, inside = project_points(maps[later][0], first[:, :3])
            depth = maps[later][1].take(at)
            points = np.flatnonzero(inside & free[later].take(at) & (np.abs(z - depth) <= error * depth))
            facing = measured[later][at[points], 3:6], first[points, 3:6]
            points = points[np.einsum("ij,ij->i", *facing) >= cosine]
            # Of several points that show a pixel the first gets it.
            owner = np.empty(len(free[later]), np.intp)
            owner[at[points[::-1]]] = points[::-1]
            points = points[owner[at[points]] == points]
            total[points] += measured[later][at[points]]
            seen[points, later], free[later][at[points]] = True, False
        count = seen.sum(1)
        enough = count >= required
        parts.append((total[enough] / count[enough, None].astype(np.float32), seen[enough]))
    points, seen = (np.concatenate(part) for part in zip(*parts, strict=True))
    return points, seen


def _measurements(view: View, depth: Array, normals: Array, picture: Array) -> Array:
    """Return place, normal and colour (n, 9), float32, that a map has at each pixel."""
    rows, columns = np.divmod(np.arange(depth.size), view.width)
    points = surface_points(view, rows, columns, depth.ravel())
    facing = normals.reshape(-1, 3) @ view.rotation.astype(np.float32)
    return np.hstack([points, facing, picture.reshape(-1, 3)[:, ::-1]])


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
    confirming, denying = (np.zeros(len(points), np.uint16) for _ in range(2))
    for name, found in depth_views.items():
        view = views[name]
        at, z, inside = project_points(view, points)
        towards = view.centre.astype(np.float32) - points
        cosine = np.einsum("ij,ij->i", towards, normals) / np.sqrt(np.einsum("ij,ij->i", towards, towards))
        confirming += inside & (cosine > 0) & (np.abs(found.depth.take(at) - z) < SLACK * z)
        # Zero if any neighbouring pixel has no depth.
        nearest = cv2.erode(found.depth, np.ones((3, 3), np.uint8)).take(at)
        denying += inside & (nearest > np.where(cosine < BEHIND, 1 - SLACK, 1 + SLACK) * z)
    return np.asarray((denying > 0) & (confirming <= 2 * denying))


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
