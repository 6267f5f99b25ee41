"""Which plane each blank patch of a picture lies on, or whether it stays as it was found."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.backends.cost_volume import WORST_COST, combine_likeness, correlate_windows
from reconstruction.depth.backends.semiglobal_aggregation import aggregate_costs
from reconstruction.depth.calibrated_image import SourceView
from reconstruction.depth.weak_texture.blank_part import MIDDLE, BlankPart
from reconstruction.depth.weak_texture.scene_planes import ScenePlane

CHANGE = 60
"""Penalty of a change of plane between neighbours, where 255 is the cost of no likeness."""
ALIKE, ALIKE_PRICE = 0.05, 0.005
"""Added to the cost (0 to 1) where a plane with more points is within this share: both match nearly as well,
and the other is more exact."""
MIN_VISIBLE = 0.02
"""Share of a picture that a plane must cover to be tried there."""
MIN_SOURCES = 2
"""That must see a pixel, where there are so many: at a rim what lies outside a picture says nothing."""
LIKE, LIKE_ON_AVERAGE = 0.3, 0.08
"""Correlation of a wide window that is evidence; and its mean over a patch of one plane."""
MIN_PATCH_PX = 12
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
    found: Array,
    planes: Sequence[ScenePlane],
    reach: tuple[float, float],
) -> PlaneChoice:
    """The plane that fits best by wide windows, the same for neighbours where nothing speaks against it.

    `found`: the inverse depth that the view had found, of the small picture's size. `planes`: those with
    most points first. `reach`: the nearest and the farthest depth.
    """
    image = part.image
    low, high = 1 / reach[1], 1 / reach[0]
    gradients, levels = [np.zeros(3, np.float32)], [found]
    for plane in planes:
        gradient = plane.inverse_depth_gradient(image.view)
        level = np.tensordot(gradient, image.rays, 1)
        if np.mean(part.there & (level > low) & (level < high)) >= MIN_VISIBLE:
            gradients.append(gradient)
            levels.append(level)
    source_views = [SourceView(image, source.image) for source in sources]
    volume = np.empty((len(found), len(levels), found.shape[1]), np.uint8)
    there = part.there
    for number, level in enumerate(levels):
        cost, seen = _cost_and_sight(np.clip(level, low, high), source_views)
        seen &= (level > low) & (level < high)
        if number == AS_FOUND:
            there = there & seen
        alike = [np.abs(level - other) < ALIKE * other for other in levels[1:number]]
        cost = cost + np.float32(ALIKE_PRICE) * np.any(alike, axis=0) if alike else cost
        cost = np.where(there, np.where(seen, np.minimum(cost, 1.0), 1.0), 0.5)
        np.multiply(cost, WORST_COST, out=volume[:, number, :], casting="unsafe")
    number = aggregate_costs(volume, part.shade, CHANGE, CHANGE).argmin(1)
    number[~there] = AS_FOUND
    likeness = 1 - np.take_along_axis(volume, number[:, None], 1)[:, 0] / WORST_COST
    evident = there & ((likeness > LIKE) | _evident_patches(number, likeness))
    return PlaneChoice(np.stack(gradients), number, evident)


def _cost_and_sight(level: Array, source_views: Sequence[SourceView]) -> tuple[Array, Array]:
    """The sources' matching cost along a surface, and where enough of them see it at all (bool)."""
    warped = [one.warp_by_depth(level) for one in source_views]
    seeing = len(warped) - np.sum([one < 0 for one in warped], axis=0)
    # What lies outside says nothing, rather than being like nothing: wide windows often reach beyond.
    inside = [np.where(one < MIDDLE / 2, np.float32(MIDDLE), one) for one in warped]
    likeness = [correlate_windows(one, part) for one, part in zip(source_views, inside, strict=True)]
    return 1 - combine_likeness(likeness), np.asarray(seeing >= min(MIN_SOURCES, len(warped)))


def _evident_patches(number: Array, likeness: Array) -> Array:
    """Patches of one plane (bool) whose windows are alike on average: each by itself is too noisy."""
    found = np.zeros(number.shape, bool)
    for one in np.unique(number[number != AS_FOUND]):
        mine = number == one
        _, patches = cv2.connectedComponents(cv2.dilate(mine.astype(np.uint8), np.ones((3, 3), np.uint8)))
        count = np.bincount(patches[mine])
        mean = np.bincount(patches[mine], likeness[mine]) / np.maximum(count, 1)
        found |= mine & ((mean > LIKE_ON_AVERAGE) & (count >= MIN_PATCH_PX))[np.where(mine, patches, 0)]
    return found
