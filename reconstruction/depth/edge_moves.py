"""Edges of a surface moved to where the pictures match: planes continued over their neighbours."""

from collections.abc import Sequence

import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.backends.cost_volume import WORST_COST
from reconstruction.depth.backends.engine import CPU, SweepEngine
from reconstruction.depth.calibrated_image import SourceView, box_filter

WAYS = ((1, 0), (-1, 0), (0, 1), (0, -1))
MIN_GAIN = 0.02
"""By how much, of 1, a plane from beside must match better than a pixel's own: noise differs, too."""
SMOOTHING_PX = 3

Planes = tuple[Array, Array, Array]
"""Inverse depth and its slope per pixel in x and y, each float32 height x width."""


def move_edges(
    planes: Planes, source_views: Sequence[SourceView], away_px: int, engine: SweepEngine = CPU
) -> Planes:
    """Every pixel's own plane, or that of a pixel `away_px` to a side, above or below if that matches better.

    Sweeps along a surface only move it nearer or farther: what was taken for the background beside an edge
    stays there. Windows bend with the surface, so that the one whose edges are right matches on both sides.
    """
    cost = _cost_along(planes[0], source_views, engine) - MIN_GAIN * WORST_COST
    best = planes
    for right, down in WAYS:
        dx, dy = away_px * right, away_px * down
        level, slope_x, slope_y = (_shifted(part, dx, dy) for part in planes)
        level = level - slope_x * np.float32(dx) - slope_y * np.float32(dy)
        found = _cost_along(level, source_views, engine)
        better = found < cost
        cost = np.where(better, found, cost)
        level, slope_x, slope_y = (
            np.where(better, new, old) for new, old in zip((level, slope_x, slope_y), best, strict=True)
        )
        best = level, slope_x, slope_y
    return best


def _cost_along(inverse_depth: Array, source_views: Sequence[SourceView], engine: SweepEngine) -> Array:
    return box_filter(engine.costs_along(source_views, inverse_depth).astype(np.float32), SMOOTHING_PX)


def _shifted(part: Array, dx: int, dy: int) -> Array:
    """The values that are dx, dy px from each pixel; at the border its own last ones."""
    height, width = part.shape
    rows = np.clip(np.arange(height) + dy, 0, height - 1)
    columns = np.clip(np.arange(width) + dx, 0, width - 1)
    return np.asarray(part[rows[:, None], columns])
