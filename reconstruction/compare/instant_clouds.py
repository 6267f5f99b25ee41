"""The fused clouds of the instant that is shown, in both conditions, as files and as a page turns them."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.common.point_file import write_points
from reconstruction.multiview.instant_depth import InstantDepth
from reconstruction.scores.results import InstantClouds

MIN_POINTS = 500
"""A synchronized cloud of fewer points shows nothing."""


def save_clouds(
    instant: int, maps: Mapping[str, InstantDepth], view: View, moving: Array, out: Path
) -> InstantClouds | None:
    """Write both clouds into out/pictures; None where there is nothing to see.

    `view` and `moving` (bool) are the reference camera's: a page begins from its place, and turns about what
    moves.
    """
    if len(maps["synced"].points) < MIN_POINTS:
        return None
    paths = {}
    for side, found in maps.items():
        paths[side] = f"pictures/cloud_{side}.ply"
        write_points(out / paths[side], found.points, found.colours)
    return InstantClouds(
        instant=instant,
        **paths,
        rotation=tuple(view.rotation.ravel().tolist()),
        centre=tuple(view.centre.tolist()),
        focal=view.focal / view.width,
        pivot=tuple(_pivot(maps["synced"], view, moving).tolist()),
    )


def _pivot(synced: InstantDepth, view: View, moving: Array) -> Array:
    """The middle of what moves, else of everything, in the rig's frame."""
    known = synced.depth > 0
    rows, columns = np.nonzero(known & moving if (known & moving).any() else known)
    if not len(rows):
        return np.asarray(np.median(synced.points, axis=0))
    points = view.unproject(np.column_stack([columns, rows]), synced.depth[rows, columns].astype(float))
    return np.asarray(np.median(points, axis=0))
