"""Depth of all cameras of an instant: independent sweeps, mutual confirmation, and proposals by others."""

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import cv2
import numpy as np

from capture_app.console.terminal import Progress
from reconstruction.common.geometry import Array
from reconstruction.common.memory import memory_budget
from reconstruction.common.worker_pool import worker_count, worker_pool
from reconstruction.depth.calibrated_image import CalibratedImage, SourceView
from reconstruction.depth.geometric_consistency import (
    consistent_and_visible_views,
)
from reconstruction.depth.kernels import call_kernel, floats
from reconstruction.depth.plane_sweep import (
    MAX_PROPOSED_COST,
    PlaneSweep,
    Surface,
)
from reconstruction.depth.sweep_kernels import fit_planes
from reconstruction.methods.multiview.blank_walls import fit_blank_walls
from reconstruction.methods.multiview.consistent_pixels import consistent_pixels
from reconstruction.methods.multiview.edge_sharpening import sharpen_edges
from reconstruction.methods.multiview.still_scene import WHOLE, StillScene, boxes_around, renewed


def propose_inverse_depth(others: Iterable[tuple[SourceView, Array]], shape: tuple[int, int]) -> Array:
    """Return the inverse depth (`shape`) of the nearest surface that others project here; 0 = none.

    The source views are from each other view to this one.
    """
    nearest = np.zeros(shape, np.float32)
    for to_this, depth in others:
        call_kernel("splat", *depth.shape, floats(depth), floats(to_this.numbers), *shape, nearest)
    return _close_gaps(nearest)


def _close_gaps(inverse_depth: Array) -> Array:
    """Close gaps of one pixel, and remove background seen between the points of a nearer surface."""
    front = cv2.morphologyEx(inverse_depth, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    return np.where(inverse_depth < 0.98 * front, front, inverse_depth).astype(np.float32)


@dataclass(frozen=True, eq=False)
class ViewDepth:
    """One camera's depth (height x width, the rig's unit, 0 = none) and normals (x 3, facing the camera)."""

    depth: Array
    normals: Array
    surface: Surface | None = None
    """The surface before the consistency check; None if COLMAP matched."""


def match_all_views(
    images: Mapping[str, CalibratedImage],
    sources: Mapping[str, Sequence[str]],
    depth_ranges: Mapping[str, tuple[float, float]],
    progress: Progress | None = None,
    *,
    has_thin: bool = False,
    quick: bool = False,
    still: StillScene | None = None,
) -> dict[str, ViewDepth]:
    """Compute depth and normals of every camera that has sources.

    `depth_ranges` and `has_thin` are the rough scene's. `progress` advances by a step after each camera.
    `quick`: a first sweep at half the size, in half the time; thin parts and edges suffer.
    `still`: depth of earlier instants, reused where nothing moved; it also stores the new results.
    Call `StillScene.look` with these images before.
    """
    still = still or StillScene()
    new = {name: still.new(name, image) for name, image in images.items()}
    steps = progress or Progress(0, silent=True)
    names = [name for name in images if sources.get(name)]
    paired = [name for name in names if [name] == [o for other in sources[name] for o in sources[other]]]
    # The memory of a cell of the matching costs.
    budget, bytes_per_cell = memory_budget(), 5
    # The number of workers must not count: depth would depend on the number of cores.
    cells = min(PlaneSweep.max_cells, int(0.4 * budget.limit_bytes / bytes_per_cell))
    sweep = PlaneSweep(max_cells=cells, first_scale=0.5 if quick else 1.0)

    def match(name: str) -> Surface:
        others = [images[other] for other in sources[name]]
        surface = still.surface(name, images[name])
        for box, mine in boxes_around(new[name]):
            swept = sweep.sweep(images[name].cropped(box), others, depth_ranges[name])
            surface = renewed(surface, swept, box, mine)
        steps.step(f"depth of {name}")
        return surface

    def sharpen(name: str) -> Surface:
        views = [SourceView(images[name], images[other]) for other in sources[name]]
        return sharpen_edges(surfaces[name], views, new[name])

    def propose(name: str) -> Surface:
        """Return the surface where others confirm it, elsewhere the others' surfaces if these match."""
        others = [images[other] for other in sources[name]]
        to_this = [SourceView(other, images[name]) for other in others]

        def from_others(depths: Mapping[str, Array]) -> Array:
            maps = zip(to_this, (depths[other] for other in sources[name]), strict=True)
            return propose_inverse_depth(maps, surfaces[name].inverse_depth.shape)

        sure = from_others(confirmed)
        proposed = sure
        if name in paired:
            # No other camera can confirm what that camera's own windows match, unless this one finds it too.
            matched = {
                o: surfaces[o].depth_where((confirmed[o] <= 0) & (surfaces[o].cost < MAX_PROPOSED_COST))
                for o in sources[name]
            }
            proposed = np.where(sure > 0, sure, from_others(matched))
        proposed = np.where(confirmed[name] > 0, 0, proposed)
        surface = surfaces[name]
        for box, mine in boxes_around(new[name]):
            before = Surface(*(np.ascontiguousarray(part[box]) for part in surfaces[name]))
            given = before, proposed[box], sure[box] > 0, images[name].cropped(box)
            swept = sweep.adopt_proposals(*given, others, depth_ranges[name])
            surface = renewed(surface, swept, box, mine)
        return surface

    with budget.reserved(worker_count() * cells * bytes_per_cell), worker_pool() as pool:
        surfaces = dict(zip(names, pool.map(match, names), strict=True))
        laid, still.planes = fit_blank_walls(images, sources, depth_ranges, surfaces, pool, still.planes)
        surfaces = {name: renewed(surfaces[name], laid[name], WHOLE, new[name]) for name in names}
        sharp = dict(zip(names, pool.map(sharpen, names), strict=True))
        confirmed = _confirmed_depths(pool, images, sources, sharp, has_thin=has_thin)
        # Where no others find the moved edges, the sweep's depth may be right.
        surfaces = {n: renewed(surfaces[n], sharp[n], WHOLE, confirmed[n] > 0) for n in names}
        surfaces = dict(zip(names, pool.map(propose, names), strict=True))
        confirmed = _confirmed_depths(pool, images, sources, surfaces, has_thin=has_thin)
        if paired:
            # Depths that one of two adopted from the other may now be visible to the other.
            surfaces |= zip(paired, pool.map(propose, paired), strict=True)
            confirmed = _confirmed_depths(pool, images, sources, surfaces, has_thin=has_thin)
        still.keep(images, sources, surfaces)
        facing = pool.map(lambda name: _view_normals(surfaces[name], images[name]), names)
        return {
            name: ViewDepth(
                confirmed[name], np.where(confirmed[name][..., None] > 0, normals, 0), surfaces[name]
            )
            for name, normals in zip(names, facing, strict=True)
        }


def _confirmed_depths(
    pool: Executor,
    images: Mapping[str, CalibratedImage],
    sources: Mapping[str, Sequence[str]],
    surfaces: Mapping[str, Surface],
    *,
    has_thin: bool,
) -> dict[str, Array]:
    """Return every view's depth where other views confirm it, elsewhere 0; float32 height x width."""

    def confirm(name: str) -> Array:
        surface = surfaces[name]
        voters = [
            (SourceView(images[name], images[other]), surfaces[other])
            for other in voting_views(name, sources, surfaces)
        ]
        count, able = consistent_and_visible_views(surface, voters)
        votes = count, able, len(voters), images[name].blank
        return surface.depth_where(consistent_pixels(surface, *votes, has_thin=has_thin))

    return dict(zip(surfaces, pool.map(confirm, surfaces), strict=True))


def voting_views(
    name: str, sources: Mapping[str, Sequence[str]], surfaces: Mapping[str, Surface]
) -> list[str]:
    """Return the other views that vote on a view's depth: at most eight, nearest by source links."""
    order = [name]
    for view in order:
        order += [other for other in sources[view] if other in surfaces and other not in order]
    # The sources first, then the sources' sources.
    return order[1:9]


def _view_normals(surface: Surface, image: CalibratedImage) -> Array:
    """Return normals, fitted over a wider neighbourhood than depth: slopes are more sensitive to noise."""
    # Neighbours this near to a common plane show its normal.
    tolerance = 0.03 * float(np.median(surface.inverse_depth))
    level, *slopes, _ = surface
    _, right, down = fit_planes(level, tolerance, slopes=np.stack(slopes), radius=3, stride=3)
    return image.surface_normals(level, right, down)
