"""The middle of the largest thing that moves in an image."""

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.scene.moving_pixels import detect_moving, dilate

EDGE_PX = 3
"""Distance from the image's edge at which an object may be cut off."""
AROUND_PX = 3
"""Distance around the moving pixels in which an object's blurred edge counts."""


def find_moving_point(image: Array, background: Array) -> Array | None:
    """Return the middle (x, y), px, of the largest moving region of a grey image, weighted by its contrast.

    None if nothing moves, or if the region touches the edge of the image.
    """
    moving = detect_moving(image, (), background)
    number, labels, boxes, _ = cv2.connectedComponentsWithStats(moving.astype(np.uint8))
    if number < 2:
        return None
    largest = 1 + int(np.argmax(boxes[1:, cv2.CC_STAT_AREA]))
    left, top, width, height = (int(side) for side in boxes[largest, :4])
    rows, columns = image.shape
    if min(left, top) < EDGE_PX or left + width > columns - EDGE_PX or top + height > rows - EDGE_PX:
        return None
    ys, xs = np.nonzero(dilate(labels == largest, AROUND_PX))
    contrast = np.abs(image[ys, xs].astype(float) - background[ys, xs])
    return np.array([contrast @ xs, contrast @ ys], float) / float(contrast.sum())
