"""Depth of one view: plane sweep, semi-global smoothing, then sweeps along the resulting surface."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import CalibratedImage, SourceView, box_filter
from reconstruction.depth.sweep_kernels import WORST_COST, cost_volume, costs_along, find_cheapest, fit_planes

MIN_GAIN = 0.02
"""Minimum gain in cost (0 to 1) for adopting a neighbouring plane; smaller gains may be noise."""
TOLERANCE = 0.8
"""Maximum distance of neighbours from a common plane, in steps of the first sweep."""
MIN_PLANES, MAX_PLANES = 24, 400
"""Minimum and maximum number of depths of the first sweep."""
MIN_WIDTH_PX = 200
STEP_PX = 1.0
"""Distance between depths of the first sweep, px, in the source in which it is largest."""
PENALTIES, FINE_PENALTIES = (20, 800), (10, 300)
"""Penalties of a step by one depth between neighbours and of any larger one, in the first sweep and in sweeps
along the surface; 255 is the cost of zero correlation."""
MAX_PROPOSED_COST = 0.8
"""Maximum cost of an adopted depth. If others confirmed the depth, this or a lower cost than before is
enough; otherwise both are required."""


def move_edges(planes: Array, source_views: Sequence[SourceView], off_px: int) -> Array:
    """Replace each pixel's plane by a neighbour's, `off_px` to any of the four sides, if it matches better.

    Planes are inverse depth and its slope per pixel in x and y, float32 3 x height x width. Sweeps along a
    surface only move it nearer or farther: a pixel beside an edge that was taken for background stays there.
    Windows bend with the surface, so the surface with the correct edges matches on both sides.
    """
    cost = smoothed_costs_along(planes[0], source_views) - MIN_GAIN * WORST_COST
    best = planes.copy()
    _, height, width = planes.shape
    # The border's planes are repeated beyond it.
    around = np.pad(planes, ((0, 0), (off_px, off_px), (off_px, off_px)), "edge")
    for right, down in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        dx, dy = off_px * right, off_px * down
        level, *slopes = around[:, off_px + dy :, off_px + dx :][:, :height, :width]
        level = level - slopes[0] * np.float32(dx) - slopes[1] * np.float32(dy)
        costs = smoothed_costs_along(level, source_views)
        for part, moved in zip(best, (level, *slopes), strict=True):
            np.copyto(part, moved, where=costs < cost)
        cost = np.minimum(costs, cost)
    return best


def smoothed_costs_along(inverse_depth: Array, source_views: Sequence[SourceView]) -> Array:
    """Return the smoothed costs along a surface, float32 height x width, 0 to `WORST_COST`."""
    return box_filter(costs_along(source_views, inverse_depth).astype(np.float32), 3)


class Refinement(NamedTuple):
    """A sweep along the surface: its step relative to the first sweep's, and the number of steps per side."""

    step_fraction: float
    steps: int
    edges_fraction: float = 0.0
    """Distance by which edges may move before the sweep, relative to the image's width."""


class Surface(NamedTuple):
    """Surface seen by a view: inverse depth, its slope per pixel in x and y, and the sources' matching cost.

    Each is float32 height x width; `cost` is 0 (equal) to 1; inverse depth is in 1 / the rig's unit.
    """

    inverse_depth: Array
    slope_x: Array
    slope_y: Array
    cost: Array

    def depth_where(self, chosen: Array) -> Array:
        """Return the depth at the chosen pixels (bool), elsewhere 0; float32 height x width."""
        return np.where(chosen, 1 / np.maximum(self.inverse_depth, 1e-12), 0).astype(np.float32)


@dataclass(frozen=True)
class PlaneSweep:
    """A plane sweep and the sweeps along its surface: their parameters."""

    window: int = 5
    """Side of the matching window, px."""
    fine_window: int = 7
    """Side of the matching window in sweeps along the surface, px."""
    refinements: tuple[Refinement, ...] = (Refinement(0.45, 3), Refinement(0.18, 3, 0.0125))
    max_cells: int = 80_000_000
    """Maximum pixels times depths of one sweep, some bytes each; larger images are reduced."""
    first_scale: float = 1.0
    """Scale of the images in the first sweep if they are wider than `MIN_WIDTH_PX`."""

    def sweep(
        self,
        reference: CalibratedImage,
        sources: Sequence[CalibratedImage],
        depth_range: tuple[float, float],
    ) -> Surface:
        """Return the surface of the reference view between two depths (nearest, farthest; the rig's unit)."""
        span = (1 / depth_range[1], 1 / depth_range[0])
        scale, count = self.plan(reference, sources, span)
        small = reference.scaled(scale)
        source_views = [SourceView(small, source.scaled(scale)) for source in sources]
        surface = self.sweep_once(small, source_views, np.linspace(*span, count))
        step = (span[1] - span[0]) / (count - 1)
        if scale < 1.0:
            surface = enlarge_surface(surface, reference)
        return self._refine(surface, reference, sources, step, self.refinements)

    def adopt_proposals(
        self,
        surface: Surface,
        proposed: Array,
        sure: Array,
        reference: CalibratedImage,
        sources: Sequence[CalibratedImage],
        depth_range: tuple[float, float],
    ) -> Surface:
        """Adopt depths that other views project into this image, if they match here too.

        `proposed`: their inverse depths, 0 = none. Where they are `sure` (bool), as others confirmed them, a
        moderate cost is enough; elsewhere they must also match better than the surface found before.

        `depth_range`: nearest and farthest depth, as in the first sweep.
        """
        span = (1 / depth_range[1], 1 / depth_range[0])
        scale, count = self.plan(reference, sources, span)
        step = scale * (span[1] - span[0]) / (count - 1)
        new = proposed > 0
        level = np.where(new, proposed, surface.inverse_depth).astype(np.float32)
        planes = fit_planes(level, 2 * TOLERANCE * step, slopes=np.stack(surface[1:3]), rounds=3)
        begun = Surface._make((*planes, surface.cost))
        swept = self._refine(begun, reference, sources, step, (Refinement(0.25, 3),))
        # A moving object is at another place in this image than the one that others confirmed.
        highest = np.full_like(surface.cost, MAX_PROPOSED_COST)
        choose = np.where(sure, np.maximum(highest, surface.cost), np.minimum(highest, surface.cost))
        new &= swept.cost < choose
        return Surface(*(np.where(new, now, before) for now, before in zip(swept, surface, strict=True)))

    def sweep_once(
        self,
        reference: CalibratedImage,
        source_views: Sequence[SourceView],
        levels: Array,
    ) -> Surface:
        """Return the surface from one sweep over the evenly spaced inverse depths `levels`."""
        step = float(levels[1] - levels[0])
        reference = replace(reference, window=self.window)
        source_views = [SourceView(reference, source_view.source) for source_view in source_views]
        costs = cost_volume(source_views, None, levels)
        place, cost = find_cheapest(costs, reference.grey, *PENALTIES)
        inverse_depth = (levels[0] + place * step).astype(np.float32)
        planes = fit_planes(inverse_depth, 2 * TOLERANCE * step, stride=2, rounds=3)
        return Surface._make((*planes, cost / WORST_COST))

    def _refine(
        self,
        surface: Surface,
        reference: CalibratedImage,
        sources: Sequence[CalibratedImage],
        step: float,
        plan: Sequence[Refinement],
    ) -> Surface:
        """Refine the surface by sweeps along it; windows bend with it, so that slanted surfaces match."""
        fine = replace(reference, window=self.fine_window)
        source_views = [SourceView(fine, source) for source in sources]
        for step_fraction, steps, edges_fraction in plan:
            planes = np.stack(surface[:3])
            if edges_fraction:
                # The reference may be a crop of its image.
                off_px = max(1, round(edges_fraction * sources[0].view.width))
                planes = move_edges(planes, source_views, off_px)
            offsets = np.arange(-steps, steps + 1) * (step * step_fraction)
            costs = cost_volume(source_views, planes[0], offsets)
            place, cost = find_cheapest(costs, reference.grey, *FINE_PENALTIES)
            inverse_depth = planes[0] + (place - steps) * np.float32(step * step_fraction)
            planes = fit_planes(inverse_depth, TOLERANCE * step, slopes=planes[1:], stride=2)
            surface = Surface._make((*planes, cost / WORST_COST))
        return surface

    def plan(
        self,
        reference: CalibratedImage,
        sources: Sequence[CalibratedImage],
        span: tuple[float, float],
    ) -> tuple[float, int]:
        """Return the scale of the images in the first sweep, and its number of depths."""
        moved = max(motion_px(SourceView(reference, source), *span) for source in sources)
        pixels = reference.grey.size
        scale = self.first_scale if reference.view.width > MIN_WIDTH_PX else 1.0
        while True:
            count = int(np.clip(np.ceil(moved * scale / STEP_PX) + 1, MIN_PLANES, MAX_PLANES))
            if count * pixels * scale**2 <= self.max_cells:
                return scale, count
            scale /= np.sqrt(2.0)


def motion_px(source_view: SourceView, low: float, high: float) -> float:
    """Return the median motion of the image's pixels in the source between two inverse depths, px."""
    ends = [source_view.project(np.full((1, 1), w, np.float32), every=8) for w in (low, high)]
    moved = np.hypot(ends[1][0] - ends[0][0], ends[1][1] - ends[0][1])
    moved = moved[np.isfinite(moved)]
    return float(np.median(moved)) if moved.size else 0.0


def enlarge_surface(surface: Surface, reference: CalibratedImage) -> Surface:
    """Enlarge the surface to the reference's size, extending each pixel's plane over its new pixels."""
    height, width = surface.inverse_depth.shape
    sx, sy = width / reference.view.width, height / reference.view.height
    x = (np.arange(reference.view.width) + 0.5) * sx - 0.5
    y = (np.arange(reference.view.height) + 0.5) * sy - 0.5
    column = np.clip(np.rint(x), 0, width - 1).astype(int)
    row = np.clip(np.rint(y), 0, height - 1).astype(int)
    level, slope_x, slope_y, cost = (part[row[:, None], column] for part in surface)
    level = (
        level + slope_x * (x - column).astype(np.float32) + slope_y * (y - row).astype(np.float32)[:, None]
    )
    return Surface(level, slope_x * np.float32(sx), slope_y * np.float32(sy), cost)
