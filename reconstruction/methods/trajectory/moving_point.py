"""The middle of the largest thing that moves in an image."""

from collections.abc import Iterable

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.scene.moving_pixels import detect_moving, dilate

EDGE_PX = 3
"""Distance from the image's edge at which an object may be cut off."""
AROUND_PX = 3
"""Distance around the moving pixels in which an object's blurred edge counts."""
MAX_STAY = 0.45
"""Fraction of the frames in which an object may cover a pixel; from a half on the background shows it."""


def find_moving_points(images: Iterable[Array], background: Array, frames: int) -> list[Array | None]:
    """Return the middle (x, y), px, of the largest moving region of each of a camera's grey images.

    `background` is the still scene in so many `frames` of the camera. Pixels count by their contrast. None
    if nothing moves, if the region touches the edge of the image, or if something stays in the region for so
    long that the background may show it.
    """
    points: list[Array | None] = []
    regions, covered = [], np.zeros(background.shape, int)
    for image in images:
        moving = detect_moving(image, (), background)
        covered += moving
        region = _largest_region(moving)
        regions.append(region)
        contrast = np.abs(image[region].astype(float) - background[region])
        points.append(
            np.array([contrast @ region[1], contrast @ region[0]]) / max(float(contrast.sum()), 1.0)
        )
    stays = covered > MAX_STAY * frames
    return [
        point if len(region[0]) and not stays[region].any() else None
        for point, region in zip(points, regions, strict=True)
    ]


def _largest_region(moving: Array) -> tuple[Array, ...]:
    """Return the rows and columns (n,) of the largest region of a mask; none if it may be cut off."""
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(moving.astype(np.uint8))
    boxes[0, cv2.CC_STAT_AREA] = 0
    largest = int(np.argmax(boxes[:, cv2.CC_STAT_AREA]))
    left, top, width, height = (int(side) for side in boxes[largest, :4])
    rows, columns = moving.shape
    if min(left, top) < EDGE_PX or left + width > columns - EDGE_PX or top + height > rows - EDGE_PX:
        return np.nonzero(np.zeros_like(moving))
    return np.nonzero(dilate(labels == largest, AROUND_PX))
