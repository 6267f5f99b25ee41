"""Screens in a camera's view: a television shows its own times, at its own rate.

A camera with another rate sees a picture of a screen twice now and then. Nothing moves there from one image
to the next, though it did before and does after. A body does not stop for a thirtieth of a second.
"""

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.scene.dataset import Dataset
from reconstruction.time_offsets.frame_jumps import NOISES
from reconstruction.time_offsets.repetition import middle_images
from reconstruction.time_offsets.rough_offset import MIN_IMAGES
from reconstruction.time_offsets.single_images import STALLED

CELL_PX, MIN_CHANGE = 8, 1.0
"""Side of a cell of the reduced image, and its least change that is motion, mean grey levels beyond noise."""
MIN_CELLS, MIN_STALLS, MIN_RATE = 4, 2, 0.1
"""Minimum number of cells that stall at once, while as many others move on: else the camera itself stalls.

Then the minimum number of such images, and their fraction: at 30 images a second each sixth shows the picture
before of a screen with 25. Of real films without a screen, 7 % do at most.
"""


def find_screen(dataset: Dataset, camera: str) -> Array:
    """Return the pixels (bool) of a camera's images in which things stall and move on, again and again."""
    (width, height), (_, images) = dataset.size(camera), middle_images(dataset, camera)
    nothing = np.zeros((height, width), bool)
    if len(images) < MIN_IMAGES:
        return nothing
    changes = np.abs(np.diff(images, axis=0))
    changes = np.maximum(changes - NOISES * np.median(changes), 0)
    cells = -(-images.shape[2] // CELL_PX), -(-images.shape[1] // CELL_PX)
    changed = np.stack([cv2.resize(change, cells, interpolation=cv2.INTER_AREA) for change in changes])
    beside = np.minimum(changed[:-2], changed[2:])
    stalls, moves = changed[1:-1] < STALLED**2 * beside, changed[1:-1] > STALLED * beside
    at_once = np.all(
        [(cell & (beside > MIN_CHANGE)).sum((1, 2)) >= MIN_CELLS for cell in (stalls, moves)], axis=0
    )
    if at_once.sum() < max(MIN_STALLS, MIN_RATE * len(at_once)):
        return nothing
    # What people hide at one time is seen at another; what changes less lies between.
    ever = np.pad((stalls & (beside > MIN_CHANGE))[at_once].any(axis=0).astype(np.uint8), 2)
    whole = cv2.dilate(cv2.morphologyEx(ever, cv2.MORPH_CLOSE, np.ones((5, 5)))[2:-2, 2:-2], np.ones((3, 3)))
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_NEAREST) > 0)
