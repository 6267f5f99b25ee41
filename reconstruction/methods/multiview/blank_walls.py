"""Blank walls: planes for image regions with hardly more than noise, where only a plane gives the depth.

First the planes with many points of all views are found, one after the other. Then each blank region is
matched with wide windows at a small scale. It takes one of the planes or keeps the depth found before.
"""

import ctypes
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View, resize_view
from reconstruction.depth.calibrated_image import CalibratedImage, SourceView
from reconstruction.depth.kernels import call_kernel, floats
from reconstruction.depth.plane_sweep import PlaneSweep, Refinement, Surface
from reconstruction.depth.sweep_kernels import WORST_COST, aggregate_costs, costs_along, fit_planes, warp

WINDOW = 7
"""Side of the matching window in small images, px."""
MIDDLE = 128.0
"""Grey level of the texture outside blank areas."""
TOLERANCE = 0.006
"""Maximum relative depth error of points on a plane."""
MIN_FRACTION = 0.004
"""Minimum fraction of an image that must be on a plane."""
LIKE, LIKE_ON_AVERAGE = 0.3, 0.08
"""Minimum correlation of a wide window that counts as evidence, and its minimum mean over a plane's patch."""
MIN_ADVANTAGE, MIN_SCATTER = 0.1, 0.06
"""Minimum mean advantage in correlation of a plane over a surface in front of it, and the scatter of relative
depth above which that surface is noise. A smooth one that matches as well is an object, perhaps moving."""
AS_FOUND = 0
"""Number of a pixel that keeps the depth found before; planes count from 1."""
EVIDENT_COST = 0.45
"""Matching cost that counts as evidence with the windows of the full-size image."""
MIN_BLANK_FRACTION = 0.02
"""Minimum blank fraction of the images."""
EVIDENT, EVIDENT_WIDE = 0.5, 0.8
"""Maximum matching costs of surface points used, with the image's own windows and with wide ones."""


@dataclass(frozen=True, eq=False)
class BlankPart:
    """Blank part of an image: its faint texture only, without edges, shading and non-blank areas.

    It is matched with windows of `WINDOW` px, far wider than the image's own. They average out noise, and are
    not affected by a rod or a leaf in front of the wall.
    """

    image: CalibratedImage
    """The texture around the grey level `MIDDLE`; exactly `MIDDLE` outside blank areas."""
    shade: Array
    """Brightness (grey levels), float32, at the small image's size."""
    there: Array
    """Blank pixels (bool) of the small image."""
    mask: Array
    """Blank pixels (bool) of the full-size image."""


def extract_blank_part(image: CalibratedImage) -> BlankPart:
    """Return the textureless part of an image, at a smaller size, with its faint shading as texture."""
    mask = image.flat
    view = image.view
    # Each pixel averages at least 16, which reduces noise.
    scale = min(0.25, 160 / view.width)
    small = resize_view(view, round(view.width * scale), round(view.height * scale))
    size = small.width, small.height
    weight = mask.astype(np.float32)
    blank_fraction = cv2.resize(weight, size, interpolation=cv2.INTER_AREA)
    shade = cv2.resize(weight * image.grey, size, interpolation=cv2.INTER_AREA) / np.maximum(
        blank_fraction, 1e-3
    )
    there = blank_fraction > 0.3
    # The bilateral filter ignores values this far from every shade.
    outside = np.where(there, shade, np.float32(-1e4)).astype(np.float32)
    # Neighbours up to six standard deviations of the noise apart have the same shade.
    around = cv2.bilateralFilter(outside, 9, 6.0 * float(np.sqrt(image.noise)) / 3, 8)
    texture = np.where(there, shade - around, 0) + np.float32(MIDDLE)
    noise = image.noise / (view.width * view.height / (small.width * small.height))
    return BlankPart(CalibratedImage(small, texture.astype(np.float32), WINDOW, noise), shade, there, mask)


class ScenePlane(NamedTuple):
    """A plane of the rig's frame: normal . X = distance, in the rig's unit."""

    normal: Array
    distance: float

    def inverse_depth_gradient(self, view: View) -> Array:
        """Return the vector (3,) whose product with a view's ray (x, y, 1) is the plane's inverse depth."""
        normal = view.rotation @ self.normal
        distance = self.distance + float(normal @ view.translation)
        return np.asarray(normal / (distance if abs(distance) > 1e-9 else 1e-9), np.float32)

    def contains(self, points: Array, tolerance: float = TOLERANCE) -> Array:
        """Return which surface points (9, n) are within a relative depth error of the plane (bool)."""
        return np.asarray(_near(self.normal[None], np.array([self.distance]), points, tolerance)[0])


def sample_surface(image: CalibratedImage, inverse_depth: Array, evident: Array) -> Array:
    """Return points of a view's surface where it is evident (bool height x width).

    They are float32 (9, n) in the rig's frame: places, normals, and the camera centre that saw them.
    """
    typical = float(np.median(inverse_depth))
    known = np.where(evident, inverse_depth, np.float32(-1e6))
    level, right, down = fit_planes(known, 3 * TOLERANCE * typical, radius=3, rounds=3)
    facing = image.surface_normals(level, right, down)
    depth = 1 / np.maximum(inverse_depth, 1e-9).astype(float)
    places = image.view.unproject_map(depth, evident)
    normals = facing[evident] @ image.view.rotation
    return np.hstack([places, normals, np.full_like(places, image.view.centre)]).T.astype(np.float32)


def find_scene_planes(samples: Sequence[Array], min_points: int) -> list[ScenePlane]:
    """Find planes that contain at least `min_points` of all surface points (9, n each), largest first."""
    left = np.ascontiguousarray(np.hstack(samples))
    planes: list[ScenePlane] = []
    while len(planes) < 32 and left.shape[1] >= min_points:
        plane = _best_supported(left)
        if np.count_nonzero(plane.contains(left)) < min_points:
            break
        planes.append(plane)
        # Points just beside it would give the same plane again.
        left = left.compress(~plane.contains(left, 2 * TOLERANCE), axis=1)
    return planes


def _best_supported(points: Array) -> ScenePlane:
    """Return the plane with the most points, fitted to them."""
    # Points whose own planes are candidates for the next plane, and points that vote on these.
    tried, judges = (points[:, :: max(1, points.shape[1] // n)] for n in (240, 2000))
    normals = tried[3:6].T
    distances = (tried[3:6] * tried[:3]).sum(0)
    support = np.count_nonzero(_near(normals, distances, judges, TOLERANCE), axis=1)
    # Without the fit of some to all points, tiny grey-level changes alter the choice.
    planes = (
        _refined(ScenePlane(normals[k], float(distances[k])), points)
        for k in np.argsort(-support, kind="stable")[:8]
    )
    return max(planes, key=lambda plane: np.count_nonzero(plane.contains(points)))


def _refined(plane: ScenePlane, points: Array) -> ScenePlane:
    """Refine a plane by repeated least squares through the points on it."""
    # Fitting to the nearest points alone keeps a tilt.
    for factor in (2.0, 1.5, 1.0, 1.0):
        on = points.compress(plane.contains(points, factor * TOLERANCE), axis=1).astype(float)
        if on.shape[1] < 3:
            break
        places, centres = on[:3], on[6:]
        weights = 1 / np.maximum(np.abs(plane.distance - plane.normal @ centres), 1e-9) ** 2
        middle = np.average(places, axis=1, weights=weights)
        deviations = places - middle[:, None]
        normal = np.linalg.eigh((deviations * weights) @ deviations.T)[1][:, 0]
        plane = ScenePlane(normal, float(normal @ middle))
    return plane


def _near(normals: Array, distances: Array, points: Array, tolerance: float) -> Array:
    """Return which points are within a relative depth error of planes, along their rays (planes x points)."""
    normals, distances = normals.astype(np.float32), distances.astype(np.float32)[:, None]
    gaps, depths = (np.abs(normals @ part - distances) for part in (points[:3], points[6:]))
    return np.asarray(gaps < np.float32(tolerance) * depths)


PlaneChoice = tuple[Array, Array, Array]
"""Each plane's `inverse_depth_gradient` (n, 3), where the entry of `AS_FOUND` is unused; each small pixel's
plane by its index, `AS_FOUND` for none; and whether it is evident (bool)."""


def choose_planes(
    part: BlankPart,
    sources: Sequence[CalibratedImage],
    found: Array,
    planes: Sequence[ScenePlane],
    depth_range: tuple[float, float],
) -> PlaneChoice:
    """Choose each pixel's plane by wide windows, with smoothness between neighbours.

    `found`: the view's inverse depth so far, at the small image's size. `planes`: candidates, those with the
    most points first. `depth_range`: nearest and farthest depth.
    """
    image = part.image
    low, high = 1 / depth_range[1], 1 / depth_range[0]
    gradients, levels = [np.zeros(3, np.float32)], [found]
    for plane in planes:
        gradient = plane.inverse_depth_gradient(image.view)
        level = np.tensordot(gradient, image.rays, 1)
        if np.mean(part.there & (level > low) & (level < high)) >= 0.02:
            gradients.append(gradient)
            levels.append(level)
    source_views = [SourceView(image, source) for source in sources]
    volume = np.empty((len(found), len(levels), found.shape[1]), np.uint8)
    repeated = np.zeros((len(levels), *found.shape), bool)
    stacked = floats(np.stack(levels))
    # Two planes within 5 % match nearly equally well; the one with more points is more accurate.
    call_kernel("repeats", len(levels), found.size, stacked, ctypes.c_float(0.05), repeated)
    there = part.there
    for number, level in enumerate(levels):
        cost, seen = _cost_and_sight(np.clip(level, low, high), source_views)
        seen &= (level > low) & (level < high)
        if number == AS_FOUND:
            there = there & seen
        cost = cost + np.float32(0.005) * repeated[number]
        cost = np.where(there, np.where(seen, np.minimum(cost, 1.0), 1.0), 0.5)
        np.multiply(cost, WORST_COST, out=volume[:, number, :], casting="unsafe")
    # 255 is the cost of zero correlation.
    number = aggregate_costs(volume, part.shade, 60, 60).argmin(1)
    number[~there] = AS_FOUND
    likeness = 1 - np.take_along_axis(volume, number[:, None], 1)[:, 0] / WORST_COST
    advantage = likeness - (1 - volume[:, AS_FOUND] / WORST_COST)
    chosen = np.take_along_axis(stacked, number[None], 0)[0]
    nearer = np.log(np.maximum(found, low) / np.clip(chosen, low, high))
    number[own_surfaces(number, advantage, nearer)] = AS_FOUND
    evident = there & ((likeness > LIKE) | evident_patches(number, likeness))
    return np.stack(gradients), number, evident


def own_surfaces(number: Array, advantage: Array, nearer: Array) -> Array:
    """Return patches of one plane (bool) whose own surface is in front of it, smooth, and matches as well.

    `advantage`: by how much the plane correlates better. `nearer`: the logarithm of the plane's depth
    relative to the surface's.
    """
    is_found = np.zeros(number.shape, bool)
    for mine, patches, _, (better, mean, square) in _patches(number, 1, advantage, nearer, nearer**2):
        in_front = (mean > 3 * TOLERANCE) & (square - mean**2 < MIN_SCATTER**2)
        is_found |= mine & ((better < MIN_ADVANTAGE) & in_front)[patches]
    return is_found


def _patches(
    number: Array, gap_px: int, *values: Array
) -> Iterator[tuple[Array, Array, Array, Sequence[Array]]]:
    """Yield each plane's pixels (bool), their patches' numbers, the patches' sizes and their mean values.

    `gap_px` is 1 for pixels that touch along their sides; larger gaps are bridged in all directions.
    """
    for plane in np.unique(number[number != AS_FOUND]):
        mine = number == plane
        wide = cv2.dilate(mine.astype(np.uint8), np.ones((gap_px, gap_px), np.uint8))
        _, patches = cv2.connectedComponents(wide, connectivity=4 if gap_px == 1 else 8)
        count = np.bincount(patches[mine])
        means = [np.bincount(patches[mine], part[mine]) / np.maximum(count, 1) for part in values]
        yield mine, np.where(mine, patches, 0), count, means


def _cost_and_sight(level: Array, source_views: Sequence[SourceView]) -> tuple[Array, Array]:
    """Return the sources' matching cost along a surface, and where enough of them see it (bool)."""
    warped = [warp(source_view, level) for source_view in source_views]
    seeing = len(warped) - np.sum([picture < 0 for picture in warped], axis=0)
    # Areas outside an image are neutral rather than a mismatch: wide windows often reach there.
    shown = [
        SourceView(
            view.reference,
            replace(
                view.reference,
                grey=np.where(one < MIDDLE / 2, np.float32(MIDDLE), one),
                noise=view.source.noise,
            ),
        )
        for view, one in zip(source_views, warped, strict=True)
    ]
    costs = costs_along(shown, np.zeros_like(level)) / np.float32(WORST_COST)
    # Areas outside an image carry no evidence.
    return costs, np.asarray(seeing >= min(2, len(warped)))


def evident_patches(number: Array, likeness: Array) -> Array:
    """Return patches of one plane (bool) with sufficient mean correlation; single windows are too noisy."""
    is_found = np.zeros(number.shape, bool)
    for mine, patches, count, (mean,) in _patches(number, 3, likeness):
        is_found |= mine & ((mean > LIKE_ON_AVERAGE) & (count >= 12))[patches]
    return is_found


def lay_planes(surface: Surface, image: CalibratedImage, mask: Array, choice: PlaneChoice) -> Surface:
    """Return the surface with the chosen planes in blank areas (`mask`) without other evidence."""
    size = image.view.width, image.view.height
    gradients, *small = choice
    number, evident = (
        cv2.resize(np.uint8(values), size, interpolation=cv2.INTER_NEAREST) for values in small
    )
    level, slope_x, slope_y, cost = (part.copy() for part in surface)
    laid = mask & (number != AS_FOUND) & (cost >= EVIDENT_COST)
    gradient = gradients[number[laid]]
    rays = image.rays
    level[laid] = (gradient * rays[:, laid].T).sum(1)
    slope_x[laid] = gradient[:, 0] * (rays[0, 0, 1] - rays[0, 0, 0])
    slope_y[laid] = gradient[:, 1] * (rays[1, 1, 0] - rays[1, 0, 0])
    sure = mask & (evident > 0)
    cost[sure] = np.minimum(cost[sure], EVIDENT_COST)
    _continue_to_edges((level, slope_x, slope_y), image, mask)
    return Surface(level, slope_x, slope_y, cost)


def _continue_to_edges(planes: tuple[Array, Array, Array], image: CalibratedImage, mask: Array) -> None:
    """Extend the planes of blank areas to the edges of objects in front of them, in place.

    Windows that contain a rod are not blank and find the rod's depth on both sides of it. The change of shade
    shows where the rod really ends.
    """
    # Windows of the full-size image extend an object's depth by as much beyond its edge.
    rim_px = 4
    weight = mask.astype(np.float32)
    window = 2 * rim_px + 1, 2 * rim_px + 1
    blank_fraction = cv2.blur(weight, window)
    shade = cv2.blur(weight * image.grey, window) / np.maximum(blank_fraction, 1e-6)
    # At most two standard deviations of the noise off the shade of the blank region beside it.
    same_shade = np.abs(image.grey - shade) < 2.0 * float(np.sqrt(image.noise)) / 3
    distance, nearest = cv2.distanceTransformWithLabels(
        (~mask).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    rows, columns = np.nonzero(~mask & same_shade & (distance <= rim_px) & (blank_fraction > 0))
    places = np.zeros((int(nearest.max()) + 1, 2), int)
    places[nearest[mask]] = np.column_stack(np.nonzero(mask))
    from_row, from_column = places[nearest[rows, columns]].T
    level, slope_x, slope_y = planes
    start = from_row, from_column
    there = level[start] + slope_x[start] * (columns - from_column) + slope_y[start] * (rows - from_row)
    behind = (there > 0) & (there < 0.99 * level[rows, columns])
    at, start = (rows[behind], columns[behind]), (from_row[behind], from_column[behind])
    level[at] = there[behind]
    slope_x[at], slope_y[at] = slope_x[start], slope_y[start]


def fit_blank_walls(
    images: Mapping[str, CalibratedImage],
    sources: Mapping[str, Sequence[str]],
    depth_ranges: Mapping[str, tuple[float, float]],
    surfaces: Mapping[str, Surface],
    pool: Executor,
    planes: list[ScenePlane] | None = None,
) -> tuple[dict[str, Surface], list[ScenePlane] | None]:
    """Return the views' surfaces with planes in blank areas where wide windows prefer them, and the planes.

    Candidates are `planes`, or, if they are unknown, those that contain many points of all views.
    """
    names = list(surfaces)
    parts = dict(zip(names, pool.map(extract_blank_part, (images[name] for name in names)), strict=True))
    if np.mean([part.mask.mean() for part in parts.values()]) < MIN_BLANK_FRACTION:
        return dict(surfaces), planes

    wide_sweep = PlaneSweep(window=WINDOW, fine_window=WINDOW, refinements=(Refinement(0.35, 4),))

    def sample(name: str) -> list[Array]:
        part, surface = parts[name], surfaces[name]
        level, cost = (_shrunk(values, part.image) for values in (surface.inverse_depth, surface.cost))
        near = sample_surface(part.image, level, cost < EVIDENT)
        others = [parts[other].image for other in sources[name]]
        wide = wide_sweep.sweep(part.image, others, depth_ranges[name])
        return [near, sample_surface(part.image, wide.inverse_depth, part.there & (wide.cost < EVIDENT_WIDE))]

    if planes is None:
        min_points = round(MIN_FRACTION * float(np.mean([part.there.size for part in parts.values()])))
        planes = find_scene_planes(
            [one for samples in pool.map(sample, names) for one in samples], min_points
        )

    def choose_surface(name: str) -> Surface:
        shrunk = _shrunk(surfaces[name].inverse_depth, parts[name].image)
        others = [parts[other].image for other in sources[name]]
        choice = choose_planes(parts[name], others, shrunk, planes, depth_ranges[name])
        return lay_planes(surfaces[name], images[name], parts[name].mask, choice)

    return dict(zip(names, pool.map(choose_surface, names), strict=True)), planes


def _shrunk(part: Array, image: CalibratedImage) -> Array:
    """Return a map at a small image's size by nearest neighbour: a mean across an edge is on no surface."""
    return np.asarray(cv2.resize(part, image.grey.shape[::-1], interpolation=cv2.INTER_NEAREST))
