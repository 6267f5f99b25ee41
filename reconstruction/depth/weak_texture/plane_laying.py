"""A view's surface with the planes that were chosen for what is blank."""

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import CalibratedImage
from reconstruction.depth.edge_moves import Planes
from reconstruction.depth.plane_sweep import Surface
from reconstruction.depth.weak_texture.plane_choice import AS_FOUND, PlaneChoice

EVIDENT_COST = 0.45
"""Matching cost that stands for evidence in the windows of the whole picture."""
RIM_PX = 4
"""How far windows of the whole picture carry the depth of a thing beyond its edge."""
LIKE_SHADE = 2.0
"""Deviations of the noise by which a pixel may differ from the shade of what is blank beside it."""


def lay_planes(surface: Surface, image: CalibratedImage, mask: Array, choice: PlaneChoice) -> Surface:
    """The surface with the chosen planes wherever the picture is blank (`mask`) and nothing matched."""
    size = image.view.width, image.view.height
    number = cv2.resize(choice.number.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    evident = cv2.resize(choice.evident.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    level, slope_x, slope_y, cost = (
        part.copy() for part in (surface.inverse_depth, surface.slope_x, surface.slope_y, surface.cost)
    )
    laid = mask & (number != AS_FOUND) & (cost >= EVIDENT_COST)
    gradient = choice.gradients[number[laid]]
    rays = image.rays
    level[laid] = (gradient * rays[:, laid].T).sum(1)
    slope_x[laid] = gradient[:, 0] * (rays[0, 0, 1] - rays[0, 0, 0])
    slope_y[laid] = gradient[:, 1] * (rays[1, 1, 0] - rays[1, 0, 0])
    sure = mask & evident
    cost[sure] = np.minimum(cost[sure], EVIDENT_COST)
    _continue_to_edges((level, slope_x, slope_y), image, mask)
    return Surface(level, slope_x, slope_y, cost)


def _continue_to_edges(planes: Planes, image: CalibratedImage, mask: Array) -> None:
    """Continue the planes of what is blank to the edge of what is before it, in place.

    Windows that hold a rod are not blank, and find its depth on both sides of it; but its shade ends there.
    """
    weight = mask.astype(np.float32)
    window = 2 * RIM_PX + 1, 2 * RIM_PX + 1
    share = cv2.blur(weight, window)
    shade = cv2.blur(weight * image.grey, window) / np.maximum(share, 1e-6)
    alike = np.abs(image.grey - shade) < LIKE_SHADE * float(np.sqrt(image.noise)) / 3
    away, nearest = cv2.distanceTransformWithLabels(
        (~mask).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    rows, columns = np.nonzero(~mask & alike & (away <= RIM_PX) & (share > 0))
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
