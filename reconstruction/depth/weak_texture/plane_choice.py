"""Which plane each blank patch of a picture lies on, or whether it stays as it was found."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.backends.semiglobal_aggregation import aggregate_costs
from reconstruction.depth.calibrated_image import CalibratedImage, SourceView, combine_costs
from reconstruction.depth.plane_sweep import WORST_COST, Surface
from reconstruction.depth.weak_texture.blank_part import BlankPart
from reconstruction.depth.weak_texture.scene_planes import ScenePlane

CHANGE = 60
"""Penalty of a change of plane between neighbours, where 255 is the cost of no likeness."""
MIN_VISIBLE = 0.02
"""Share of a picture that a plane must cover to be tried there."""
LIKE, LIKE_ON_AVERAGE = 0.3, 0.08
"""Correlation of a wide window that is evidence; and its mean over a patch of one plane."""
MIN_PATCH_PX = 12
EVIDENT_COST = 0.45
"""Matching cost that stands for evidence in the windows of the whole picture."""
MIN_SOURCES = 2
"""That must see a pixel, where there are so many: at a rim what lies outside a picture says nothing."""
AS_FOUND = 0


@dataclass(frozen=True, eq=False)
class PlaneChoice:
    """Each small pixel's plane: its number, `AS_FOUND` for none; and whether it is evident (bool)."""

    gradients: Array
    """Of the planes (n, 3), by their number; that of `AS_FOUND` means nothing."""
    number: Array
    evident: Array


def choose_planes(
    part: BlankPart,
    sources: Sequence[BlankPart],
    surface: Surface,
    planes: Sequence[ScenePlane],
    reach: tuple[float, float],
) -> PlaneChoice:
    """The plane that fits best by wide windows, the same for neighbours where nothing speaks against it."""
    image = part.image
    low, high = 1 / reach[1], 1 / reach[0]
    gradients, levels = [np.zeros(3, np.float32)], [shrink(surface.inverse_depth, image)]
    for plane in planes:
        gradient = plane.inverse_depth_gradient(image.view)
        level = np.tensordot(gradient, image.rays, 1)
        if np.mean(part.there & (level > low) & (level < high)) >= MIN_VISIBLE:
            gradients.append(gradient)
            levels.append(level)
    source_views = [SourceView(image, source.image) for source in sources]
    shape = image.grey.shape
    volume = np.empty((shape[0], len(levels), shape[1]), np.uint8)
    there = part.there
    for number, level in enumerate(levels):
        warped = [one.warp_by_depth(np.clip(level, low, high)) for one in source_views]
        seen = (level > low) & (level < high)
        seen &= np.sum([one >= 0 for one in warped], axis=0) >= min(MIN_SOURCES, len(warped))
        if number == AS_FOUND:
            there = part.there & seen
        cost = combine_costs([one.matching_cost(w) for one, w in zip(source_views, warped, strict=True)])
        cost = np.where(there, np.where(seen, cost, 1.0), 0.5)
        np.multiply(cost, WORST_COST, out=volume[:, number, :], casting="unsafe")
    number = aggregate_costs(volume, part.shade, CHANGE, CHANGE).argmin(1)
    likeness = 1 - np.take_along_axis(volume, number[:, None], 1)[:, 0] / WORST_COST
    number[~there] = AS_FOUND
    evident = there & ((likeness > LIKE) | _evident_patches(number, likeness, there))
    return PlaneChoice(np.stack(gradients), number, evident)


def _evident_patches(number: Array, likeness: Array, there: Array) -> Array:
    """Patches of one plane (bool) whose windows are alike on average: each by itself is too noisy."""
    found = np.zeros_like(there)
    for one in np.unique(number[there]):
        if one == AS_FOUND:
            continue
        mine = there & (number == one)
        _, patches = cv2.connectedComponents(cv2.dilate(mine.astype(np.uint8), np.ones((3, 3), np.uint8)))
        count = np.bincount(patches[mine])
        mean = np.bincount(patches[mine], likeness[mine]) / np.maximum(count, 1)
        found |= mine & ((mean > LIKE_ON_AVERAGE) & (count >= MIN_PATCH_PX))[np.where(mine, patches, 0)]
    return found


def lay_planes(surface: Surface, image: CalibratedImage, mask: Array, choice: PlaneChoice) -> Surface:
    """The surface with the chosen planes wherever the picture is blank (`mask`)."""
    size = image.view.width, image.view.height
    number = cv2.resize(choice.number.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    evident = cv2.resize(choice.evident.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    level, slope_x, slope_y, cost = (
        part.copy() for part in (surface.inverse_depth, surface.slope_x, surface.slope_y, surface.cost)
    )
    laid = mask & (number != AS_FOUND) & (surface.cost >= EVIDENT_COST)
    gradient = choice.gradients[number[laid]]
    rays = image.rays
    level[laid] = (gradient * rays[:, laid].T).sum(1)
    slope_x[laid] = gradient[:, 0] * (rays[0, 0, 1] - rays[0, 0, 0])
    slope_y[laid] = gradient[:, 1] * (rays[1, 1, 0] - rays[1, 0, 0])
    sure = mask & evident
    cost[sure] = np.minimum(cost[sure], EVIDENT_COST)
    return Surface(level, slope_x, slope_y, cost)


def shrink(part: Array, image: CalibratedImage) -> Array:
    """A map at the size of a small picture, pixels as they are: a mean over an edge is on no surface."""
    size = image.view.width, image.view.height
    return np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_NEAREST))
