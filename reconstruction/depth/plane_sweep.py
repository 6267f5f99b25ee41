"""One view's depth: plane sweep, semi-global smoothing, then sweeps along the surface found."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import CalibratedImage, SourceView, box_filter
from reconstruction.depth.cost_volume import WORST_COST
from reconstruction.depth.engine import CPU, SweepEngine
from reconstruction.depth.plane_fitting import fit_planes

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


TOLERANCE = 1.0
"""Neighbours on one plane are within so many steps of the first sweep of it."""

MIN_PLANES, MAX_PLANES = 24, 400
"""Depths of the first sweep."""


class Refinement(NamedTuple):
    """A sweep along the surface: its step, in steps of the first sweep, and how many of them on each side."""

    step_share: float
    steps: int
    edges_share: float = 0.0
    """By which share of the picture's width edges may move before."""


@dataclass(frozen=True)
class SweepOptions:
    """How the matcher weighs matching costs against smoothness."""

    step_px: float = 0.8
    """Distance between the depths of the first sweep, in the source in which it is largest."""
    window: int = 5
    """Side of the window that is matched, px."""
    fine_window: int = 7
    """Side of the window in sweeps along the surface, px."""
    small_step: int = 20
    """Penalty of a step by one depth between neighbours, where 255 is the cost of no likeness."""
    large_step: int = 800
    """Penalty of any larger step."""
    fine_small_step: int = 10
    """Penalty of a step by one depth in sweeps along the surface."""
    fine_large_step: int = 300
    """Penalty of any larger step there."""
    refinements: tuple[Refinement, ...] = (Refinement(0.5, 4, 0.0125), Refinement(0.25, 4, 0.005))
    max_proposed_cost: float = 0.8
    """A depth that others confirmed must match as well as this, or better than what was found before; one
    that nobody confirmed both."""
    max_cells: int = 80_000_000
    """Pixels times depths of one sweep, some bytes each; larger pictures are swept at a smaller size."""


@dataclass(frozen=True, eq=False)
class Surface:
    """What a view sees: inverse depth, its slope per pixel in x and y, and the sources' matching cost.

    Each float32 height x width; `cost` is 0 (the same) to 1; inverse depth in 1 / the rig's unit.
    """

    inverse_depth: Array
    slope_x: Array
    slope_y: Array
    cost: Array


@dataclass(frozen=True, eq=False)
class Proposals:
    """Inverse depths that others put into a view's picture (0 = none), and which are confirmed (bool)."""

    inverse_depth: Array
    sure: Array


def sweep_view(
    reference: CalibratedImage,
    sources: Sequence[CalibratedImage],
    nearest: float,
    farthest: float,
    options: SweepOptions,
    engine: SweepEngine = CPU,
) -> Surface:
    """The surface that the reference view sees between two depths (the rig's unit)."""
    span = (1 / farthest, 1 / nearest)
    scale, count = _plan_first_sweep(reference, sources, span, options)
    small = reference.scaled(scale)
    source_views = [SourceView(small, source.scaled(scale)) for source in sources]
    surface = sweep_planes(small, source_views, np.linspace(*span, count), options, engine)
    step = (span[1] - span[0]) / (count - 1)
    if scale < 1.0:
        surface = _enlarge_surface(surface, reference)
    fine = replace(reference, window=options.fine_window)
    plan = options.refinements if scale == 1.0 else (*options.refinements, Refinement(0.25 * scale, 4))
    source_views = [SourceView(fine, source) for source in sources]
    return _refine_surface(surface, fine, source_views, step, plan, options, engine)


def adopt_proposals(
    surface: Surface,
    proposals: Proposals,
    reference: CalibratedImage,
    sources: Sequence[CalibratedImage],
    depth_range: tuple[float, float],
    options: SweepOptions,
    engine: SweepEngine = CPU,
) -> Surface:
    """The surface with proposals for some of its pixels where they match too.

    Sure ones must match at all, others better than what was found before.

    `depth_range`: the nearest and the farthest depth, as in the first sweep.
    """
    span = (1 / depth_range[1], 1 / depth_range[0])
    scale, count = _plan_first_sweep(reference, sources, span, options)
    step = scale * (span[1] - span[0]) / (count - 1)
    new = proposals.inverse_depth > 0
    level = np.where(new, proposals.inverse_depth, surface.inverse_depth).astype(np.float32)
    slopes = surface.slope_x, surface.slope_y
    planes = fit_planes(level, 2 * TOLERANCE * step, slopes=slopes, radius=2, rounds=3)
    fine = replace(reference, window=options.fine_window)
    source_views = [SourceView(fine, source) for source in sources]
    plan = (Refinement(0.25, 3),)
    swept = _refine_surface(Surface(*planes, surface.cost), fine, source_views, step, plan, options, engine)
    # What moves between the pictures is elsewhere in this one than others have confirmed.
    highest = np.full_like(surface.cost, options.max_proposed_cost)
    choose = np.where(proposals.sure, np.maximum(highest, surface.cost), np.minimum(highest, surface.cost))
    new &= swept.cost < choose
    return Surface(
        np.where(new, swept.inverse_depth, surface.inverse_depth),
        np.where(new, swept.slope_x, surface.slope_x),
        np.where(new, swept.slope_y, surface.slope_y),
        np.where(new, swept.cost, surface.cost),
    )


def sweep_planes(
    reference: CalibratedImage,
    source_views: Sequence[SourceView],
    levels: Array,
    options: SweepOptions,
    engine: SweepEngine = CPU,
) -> Surface:
    """The surface by these evenly spaced inverse depths alone."""
    step = float(levels[1] - levels[0])
    reference = replace(reference, window=options.window)
    source_views = [SourceView(reference, source_view.source) for source_view in source_views]
    volume = engine.cost_volume(source_views, None, levels)
    place, cost = engine.find_cheapest(volume, reference.grey, options.small_step, options.large_step)
    found = (levels[0] + place * step).astype(np.float32)
    planes = fit_planes(found, 2 * TOLERANCE * step, radius=2, stride=2, rounds=3)
    return Surface(*planes, cost / WORST_COST)


def _refine_surface(
    surface: Surface,
    reference: CalibratedImage,
    source_views: Sequence[SourceView],
    step: float,
    plan: Sequence[Refinement],
    options: SweepOptions,
    engine: SweepEngine,
) -> Surface:
    """The surface after sweeps along itself: windows bend with it, so that slanted surfaces match."""
    for share, steps, edges_share in plan:
        planes = surface.inverse_depth, surface.slope_x, surface.slope_y
        if edges_share:
            edges_px = max(1, round(edges_share * reference.view.width))
            planes = move_edges(planes, source_views, edges_px, engine)
        level, slope_x, slope_y = planes
        offsets = np.arange(-steps, steps + 1) * (step * share)
        volume = engine.cost_volume(source_views, level, offsets)
        penalties = options.fine_small_step, options.fine_large_step
        place, cost = engine.find_cheapest(volume, reference.grey, *penalties)
        found = level + (place - steps) * np.float32(step * share)
        planes = fit_planes(found, TOLERANCE * step, slopes=(slope_x, slope_y), radius=2, stride=2)
        surface = Surface(*planes, cost / WORST_COST)
    return surface


def _plan_first_sweep(
    reference: CalibratedImage,
    sources: Sequence[CalibratedImage],
    span: tuple[float, float],
    options: SweepOptions,
) -> tuple[float, int]:
    """Size of the pictures in the first sweep, and how many depths it takes."""
    moved = max(motion_px(SourceView(reference, source), *span) for source in sources)
    scale, pixels = 1.0, reference.grey.size
    while True:
        count = int(np.clip(np.ceil(moved * scale / options.step_px) + 1, MIN_PLANES, MAX_PLANES))
        if count * pixels * scale**2 <= options.max_cells:
            return scale, count
        scale /= np.sqrt(2.0)


def motion_px(source_view: SourceView, low: float, high: float) -> float:
    """How far a pixel moves in the source between two inverse depths: the median over the picture, px."""
    ends = [source_view.project(np.full((1, 1), w, np.float32)) for w in (low, high)]
    moved = np.hypot(ends[1][0] - ends[0][0], ends[1][1] - ends[0][1])[::8, ::8]
    moved = moved[np.isfinite(moved)]
    return float(np.median(moved)) if moved.size else 0.0


def _enlarge_surface(surface: Surface, reference: CalibratedImage) -> Surface:
    """The surface at the reference's own size, every pixel's plane continued over the pixels it becomes."""
    height, width = surface.inverse_depth.shape
    sx, sy = width / reference.view.width, height / reference.view.height
    x = (np.arange(reference.view.width) + 0.5) * sx - 0.5
    y = (np.arange(reference.view.height) + 0.5) * sy - 0.5
    column = np.clip(np.rint(x), 0, width - 1).astype(int)
    row = np.clip(np.rint(y), 0, height - 1).astype(int)
    parts = surface.inverse_depth, surface.slope_x, surface.slope_y, surface.cost
    level, slope_x, slope_y, cost = (part[row[:, None], column] for part in parts)
    level = (
        level + slope_x * (x - column).astype(np.float32) + slope_y * (y - row).astype(np.float32)[:, None]
    )
    return Surface(level, slope_x * np.float32(sx), slope_y * np.float32(sy), cost)
