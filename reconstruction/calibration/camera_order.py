"""The order of a rig's cameras from left to right, along a row, an arc or a ring."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from reconstruction.common.geometry import Array, View


def order_by_place(views: Mapping[str, View]) -> tuple[str, ...]:
    """The shortest path past all cameras, from left to right as they see it.

    The distance between two cameras is that of their places, in
    shares of the rig's size, together with that of their viewing directions. So the path follows a row or an
    arc, a ring from its largest gap on, and the viewing directions of cameras that stand in one spot.
    """
    names = sorted(views)
    if len(names) < 2:
        return tuple(names)
    centres = np.array([views[name].centre for name in names])
    size = float(np.linalg.norm(centres[:, None] - centres[None], axis=2).max())
    axes = np.array([views[name].axis for name in names])
    places = np.hstack([centres / size, axes]) if size > 1e-9 else axes
    distance = np.linalg.norm(places[:, None] - places[None], axis=2)
    paths = [_uncrossed(_nearest_neighbour_path(distance, start), distance) for start in range(len(names))]
    path = min(paths, key=lambda steps: (round(_path_length(steps, distance), 9), steps))
    first, last = views[names[path[0]]], views[names[path[-1]]]
    right = np.mean([view.rotation[0] for view in views.values()], axis=0)
    # Where cameras stand in one spot, the one that looks farther left is the first.
    across = (last.centre - first.centre) / size if size > 1e-9 else last.axis - first.axis
    if float(across @ right) < 0:
        path = path[::-1]
    return tuple(names[i] for i in path)


def _nearest_neighbour_path(distance: Array, start: int) -> list[int]:
    path, left = [start], set(range(len(distance))) - {start}
    while left:
        here = path[-1]
        path.append(min(left, key=lambda there: (distance[here, there], there)))
        left.remove(path[-1])
    return path


def _uncrossed(path: list[int], distance: Array) -> list[int]:
    """The path with stretches turned round for as long as that makes it shorter (2-opt)."""
    shorter = True
    while shorter:
        shorter = False
        for i in range(len(path) - 1):
            for j in range(i + 1, len(path)):
                turned = path[:i] + path[i : j + 1][::-1] + path[j + 1 :]
                if _path_length(turned, distance) < _path_length(path, distance) - 1e-9:
                    path, shorter = turned, True
    return path


def _path_length(path: Sequence[int], distance: Array) -> float:
    return float(sum(distance[a, b] for a, b in pairwise(path)))
