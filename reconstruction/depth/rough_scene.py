"""Coarse location of the scene, found by matching small images of neighbouring views."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from capture_app.common.errors import NotApplicableError
from reconstruction.common.geometry import Array, View
from reconstruction.common.worker_pool import worker_pool
from reconstruction.depth.calibrated_image import CalibratedImage, SourceView
from reconstruction.depth.geometric_consistency import (
    consistent_and_visible_views,
    remove_speckles,
)
from reconstruction.depth.plane_sweep import PlaneSweep, Surface, motion_px
from reconstruction.depth.view_choice import (
    MIN_SCORE,
    ViewOverlap,
    choose_reference_view,
    find_overlaps,
    refuse_views,
    seen_points,
)

WIDTH_PX = 176
LEVELS = (48, 192)
MIN_PIXELS = 150
MIN_ISLAND_PX = 30
MAX_COST = 0.35
POINTS_PER_VIEW = 400
RELATIVE_DEPTH = 0.06
"""Maximum relative depth difference between small images that agree."""
NEAR_MARGIN, FAR_MARGIN = 1.2, 2.0
"""How much nearer and farther than the points depth is looked for: faint walls and floors have none.

`make bench NAME=confidence BENCH="--rooms 36"` on 2026-11-30."""
THIN_WIDTH_PX, THIN_WINDOW = 320, 3
"""Width of the image that shows things too thin for smaller ones, and the side of its windows, px."""
THIN_MARGIN, NEARER = 1.1, 1.6
"""How much nearer than the points, at least and at most, such things are looked for."""
MAX_THIN_COST, MIN_THIN_ISLAND_PX, MIN_THIN_PX = 0.2, 20, 40
"""Maximum cost of their pixels, minimum size of their islands, and minimum number of all their pixels."""


@dataclass(frozen=True, eq=False)
class RoughScene:
    """Points (n, 3) of the scene in the rig's frame, and nearest and farthest depth in its unit, by camera.

    A camera's points: its own that neighbours confirm, and its neighbours' in its image.
    """

    points: Mapping[str, Array]
    depth_ranges: Mapping[str, tuple[float, float]]
    has_thin: bool = False
    """Whether things that are too thin for small images are nearer than all else."""


def find_rough_scene(images: Mapping[str, CalibratedImage]) -> RoughScene:
    """Match all cameras' small images with their neighbours', and return the confirmed points.

    Raises:
        NotApplicableError: no two cameras' views overlap, or no two images agree on any depth.
    """
    overlaps = {name: find_overlaps({n: i.view for n, i in images.items()}, name) for name in images}
    neighbours = {name: choose_neighbours(overlap) for name, overlap in overlaps.items()}
    if not any(neighbours.values()):
        raise refuse_views({name: image.view for name, image in images.items()})
    small = {name: image.scaled(min(1.0, WIDTH_PX / image.view.width)) for name, image in images.items()}

    def sweep(name: str) -> Surface:
        source_views = [SourceView(small[name], small[other]) for other in neighbours[name]]
        levels = _levels(source_views, [overlaps[name][other].span for other in neighbours[name]])
        return PlaneSweep().sweep_once(small[name], source_views, levels)

    with worker_pool() as pool:
        names = [name for name in images if neighbours[name]]
        surfaces = dict(zip(names, pool.map(sweep, names), strict=True))
        confirmed = pool.map(lambda name: _confirmed_points(name, small, surfaces, neighbours[name]), names)
        own = dict(zip(names, confirmed, strict=True))
    views = {name: images[name].view for name in names}
    points = {name: _shared_points(name, views, own, neighbours[name]) for name in names}
    points = {name: own_points for name, own_points in points.items() if len(own_points) >= MIN_PIXELS}
    if not points:
        raise _nothing_in_common(views, neighbours)
    ranges = {name: point_range(views[name], own_points) for name, own_points in points.items()}
    middle = choose_reference_view({name: views[name] for name in points}, points)
    thin = _thin_points(images[middle], [images[other] for other in neighbours[middle]], ranges[middle])
    depth_ranges = {name: _extended(ranges[name], views[name], thin) for name in ranges}
    return RoughScene(points, depth_ranges, has_thin=len(thin) > 0)


def choose_neighbours(overlaps: Mapping[str, ViewOverlap]) -> tuple[str, ...]:
    """Return the views that overlap most with a given view, over all depths, best first."""
    fit = [other for other, overlap in overlaps.items() if overlap.score >= MIN_SCORE and overlap.span[1] > 0]
    return tuple(sorted(fit, key=lambda other: (-overlaps[other].typical_score, other))[:3])


def _levels(source_views: Sequence[SourceView], spans: Sequence[tuple[float, float]]) -> Array:
    low, high = min(span[0] for span in spans), max(span[1] for span in spans)
    moved = max(motion_px(source_view, low, high) for source_view in source_views)
    return np.linspace(max(low, 0.002 * high), high, int(np.clip(moved, *LEVELS)))


def _confirmed_points(
    name: str,
    small: Mapping[str, CalibratedImage],
    surfaces: Mapping[str, Surface],
    neighbours: Sequence[str],
) -> Array:
    """Return some of a view's points that its neighbours' surfaces confirm."""
    surface = surfaces[name]
    others = [(SourceView(small[name], small[o]), surfaces[o]) for o in neighbours if o in surfaces]
    count, able = consistent_and_visible_views(surface, others, RELATIVE_DEPTH)
    # Two others if three can see it: a moving object finds one that agrees by chance.
    agreed = (count >= np.clip(able.astype(np.int16) - 1, 1, 2)) & (surface.cost < MAX_COST)
    agreed = remove_speckles(agreed, surface.inverse_depth, MIN_ISLAND_PX)
    rows, columns = np.nonzero(agreed)
    rows, columns = (axis[:: max(1, len(axis) // POINTS_PER_VIEW)] for axis in (rows, columns))
    pixels = np.column_stack([columns, rows]).astype(float)
    return small[name].view.unproject(pixels, 1 / surface.inverse_depth[rows, columns].astype(float))


def _shared_points(
    name: str, views: Mapping[str, View], points: Mapping[str, Array], neighbours: Sequence[str]
) -> Array:
    others = (points[other] for other in neighbours if other in points)
    return np.concatenate([points[name], *(p[seen_points(views[name], views[name], p)[0]] for p in others)])


def point_range(view: View, points: Array) -> tuple[float, float]:
    """Return the nearest and farthest depth of points (n, 3) in a view, without outliers."""
    low, high = np.percentile(1 / (points @ view.rotation.T + view.translation)[:, 2], [0.5, 99.5])
    return float(1 / high), float(1 / low)


def _thin_points(
    image: CalibratedImage, others: Sequence[CalibratedImage], depth_range: tuple[float, float]
) -> Array:
    """Return points (n, 3) of things nearer than a view's others that are too thin for the small images."""
    nearest, farthest = depth_range[0] / THIN_MARGIN, THIN_MARGIN * depth_range[1]
    reference, *sources = (
        picture.scaled(min(1.0, THIN_WIDTH_PX / picture.view.width)) for picture in (image, *others)
    )
    source_views = [SourceView(reference, source) for source in sources]
    levels = _levels(source_views, [(1 / farthest, NEARER / nearest)])
    level, _, _, cost = PlaneSweep(window=THIN_WINDOW).sweep_once(reference, source_views, levels)
    thin = remove_speckles((level * nearest > 1) & (cost < MAX_THIN_COST), level, MIN_THIN_ISLAND_PX)
    if thin.sum() < MIN_THIN_PX:
        return np.empty((0, 3))
    # Nearer ones may be chance.
    rows, columns = np.nonzero(thin & (level <= np.percentile(level[thin], 75)))
    return reference.view.unproject(np.column_stack([columns, rows]).astype(float), 1 / level[rows, columns])


def _extended(depth_range: tuple[float, float], view: View, thin: Array) -> tuple[float, float]:
    """Return the range of depth that is searched: wider than that of points, with thin things (n, 3)."""
    seen = thin[seen_points(view, view, thin)[0]] @ view.rotation.T + view.translation
    nearest = min(depth_range[0] / NEAR_MARGIN, float(seen[:, 2].min(initial=np.inf)) / 1.05)
    return max(nearest, depth_range[0] / THIN_MARGIN / NEARER), FAR_MARGIN * depth_range[1]


def _nothing_in_common(
    views: Mapping[str, View], neighbours: Mapping[str, Sequence[str]]
) -> NotApplicableError:
    tried = ", ".join(f"{name} with {' and '.join(others)}" for name, others in neighbours.items() if others)
    return NotApplicableError(
        f"the pictures of this instant have no matching points to measure depth with: tried {tried}",
        hint="cameras must see the same things from different places, lit and in focus, "
        "and their calibration must be this rig's",
    )
