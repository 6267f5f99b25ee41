"""Fusion's kernels said once more with NumPy and OpenCV, for the tests of the compiled ones."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.methods.multiview.fusion import BEHIND, SLACK, PosedMap, project_points, surface_points
from reconstruction.methods.multiview.sweep_matcher import ViewDepth


def fuse_arrays(maps: Sequence[PosedMap], required: int, error: float, cosine: float) -> tuple[Array, Array]:
    """Fuse as `fuse_posed_maps`, except for rounding."""
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


def denied_by_arrays(
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
