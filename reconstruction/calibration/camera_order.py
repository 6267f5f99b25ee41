"""The order of a rig's cameras from left to right, along a row, an arc or a ring."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from reconstruction.common.geometry import Array, View


def order_by_place(views: Mapping[str, View]) -> tuple[str, ...]:
    """The shortest path past all cameras, from left to right as they see it.

    Cameras are near each other that stand and look alike: their distance is that of their places, in
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
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    walks = [_uncrossed(_nearest_neighbour_path(apart, start), apart) for start in range(len(names))]
    walk = min(walks, key=lambda steps: (round(_length(steps, apart), 9), steps))
    first, last = views[names[walk[0]]], views[names[walk[-1]]]
    right = np.mean([view.rotation[0] for view in views.values()], axis=0)
    # Where cameras stand in one spot, the one that looks farther left is the first.
    across = (last.centre - first.centre) / size if size > 1e-9 else last.axis - first.axis
    if float(across @ right) < 0:
        walk = walk[::-1]
    return tuple(names[i] for i in walk)


def _nearest_neighbour_path(apart: Array, start: int) -> list[int]:
    walk, left = [start], set(range(len(apart))) - {start}
    while left:
        here = walk[-1]
        walk.append(min(left, key=lambda there: (apart[here, there], there)))
        left.remove(walk[-1])
    return walk


def _uncrossed(walk: list[int], apart: Array) -> list[int]:
    """The walk with stretches turned round for as long as that makes it shorter (2-opt)."""
    shorter = True
    while shorter:
        shorter = False
        for i in range(len(walk) - 1):
            for j in range(i + 1, len(walk)):
                turned = walk[:i] + walk[i : j + 1][::-1] + walk[j + 1 :]
                if _length(turned, apart) < _length(walk, apart) - 1e-9:
                    walk, shorter = turned, True
    return walk


def _length(walk: Sequence[int], apart: Array) -> float:
    return float(sum(apart[a, b] for a, b in pairwise(walk)))
