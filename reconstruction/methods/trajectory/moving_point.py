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
    points, covered = [], np.zeros(background.shape, int)
    for image in images:
        moving = detect_moving(image, (), background)
        covered += moving
        box, region = _largest_region(moving)
        contrast = region * np.abs(image[box].astype(float) - background[box])
        corner = [side.start for side in box[::-1]]
        ys, xs = np.nonzero(region)
        weights = contrast[ys, xs] / max(float(contrast.sum()), 1.0)
        points.append((corner + np.array([weights @ xs, weights @ ys]), box, np.packbits(region)))
    stays = covered > MAX_STAY * frames
    return [
        middle if bits.any() and not (np.packbits(stays[box]) & bits).any() else None
        for middle, box, bits in points
    ]


def _largest_region(moving: Array) -> tuple[tuple[slice, ...], Array]:
    """Return the box of the largest region of a mask, and its pixels (bool); empty if it may be cut off."""
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(moving.astype(np.uint8))
    boxes[0, cv2.CC_STAT_AREA] = 0
    largest = int(np.argmax(boxes[:, cv2.CC_STAT_AREA]))
    left, top, width, height = (int(side) for side in boxes[largest, :4])
    rows, columns = moving.shape
    whole = min(left, top, columns - left - width, rows - top - height) >= EDGE_PX
    ends = ((top, top + height), (left, left + width)) if whole else ((AROUND_PX, AROUND_PX),) * 2
    box = tuple(slice(first - AROUND_PX, end + AROUND_PX) for first, end in ends)
    return box, dilate(labels[box] == largest, AROUND_PX) & whole
