"""Screens in a camera's view: a television shows its own times, at its own rate.

A camera with another rate sees a picture of a screen twice now and then. Nothing moves there from one image
to the next, though it did before and does after. A body does not stop for a thirtieth of a second. A screen
of any rate has corners at rest, within which nearly all changes all the time. A body's corners move with it.
"""

import cv2
import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.scene.dataset import Dataset
from reconstruction.time_offsets.frame_jumps import NOISES
from reconstruction.time_offsets.repetition import middle_images
from reconstruction.time_offsets.rough_offset import MIN_IMAGES
from reconstruction.time_offsets.single_images import STALLED

MIN_CHANGE = 1.0
"""Minimum change of a pixel or a cell of the reduced image that is motion, grey levels beyond noise."""
MIN_CELLS = 4
"""Minimum number of cells that stall at once, while as many others move on: else the camera itself stalls."""
EDGE_PX, MIN_WITHIN = 12, 0.55
"""Length of a corner's edges in the reduced image, and the minimum fraction of images that change along them.

In the first and the last third of a take, it is 0.65 to 0.9 in the second clearest corner of a screen of the
cameras' own rate behind people, at most 0.45 of slow boards and discs (simulated), and 0.25 in real films.
"""


def find_screen(dataset: Dataset, camera: str) -> Array:
    """Return the pixels (bool) of a camera's images that show a screen and what passes before it."""
    (width, height), (_, images) = dataset.size(camera), middle_images(dataset, camera)
    if len(images) < MIN_IMAGES:
        return np.zeros((height, width), bool)
    changes = np.abs(np.diff(images, axis=0))
    changes = np.maximum(changes - NOISES * np.median(changes), 0)
    stalling, framed = (
        cv2.resize(np.uint8(find(changes)), (width, height), interpolation=cv2.INTER_NEAREST) > 0
        for find in (_find_stalling, _find_framed)
    )
    return np.asarray(stalling | framed)


def _find_stalling(changes: Array) -> Array:
    """Return the cells (bool; 8 x 8 px) of changes (t, h, w) in which things stall and move on repeatedly."""
    high, wide = (-(-side // 8) for side in changes.shape[1:])
    changed = np.stack([cv2.resize(change, (wide, high), interpolation=cv2.INTER_AREA) for change in changes])
    beside = np.minimum(changed[:-2], changed[2:])
    stalls, moves = changed[1:-1] < STALLED**2 * beside, changed[1:-1] > STALLED * beside
    at_once = np.all(
        [(cell & (beside > MIN_CHANGE)).sum((1, 2)) >= MIN_CELLS for cell in (stalls, moves)], axis=0
    )
    # At 30 images a second each sixth shows a screen's picture of 25 again; in real films 7 % stall at most.
    if at_once.sum() < max(2, len(at_once) / 10):
        return np.zeros((high, wide), bool)
    # What people hide at one time is seen at another; what changes less is between.
    ever = np.pad((stalls & (beside > MIN_CHANGE))[at_once].any(axis=0).astype(np.uint8), 2)
    whole = cv2.morphologyEx(ever, cv2.MORPH_CLOSE, np.ones((5, 5)))[2:-2, 2:-2]
    return np.asarray(cv2.dilate(whole, np.ones((3, 3))))


def _find_framed(changes: Array) -> Array:
    """Return the rectangle (bool) of changes (t, h, w) that go on between two or more corners at rest."""
    parts = [part.mean(axis=0, dtype=np.float32) for part in np.array_split(changes > MIN_CHANGE, 3)[::2]]
    always = np.pad(np.minimum(*parts), EDGE_PX)
    # What goes on beyond the picture's border is not known.
    ever = np.pad(np.maximum(*parts), EDGE_PX, constant_values=1)
    inside, corners = cv2.morphologyEx(always + ever, cv2.MORPH_OPEN, np.ones((5, 5))) > 1, 0
    for turn in np.s_[::1, ::1], np.s_[::1, ::-1], np.s_[::-1, ::1], np.s_[::-1, ::-1]:
        within = _within_corner(always[turn], ever[turn])
        if within.max() >= MIN_WITHIN:
            down, right = np.argwhere(within == within.max())[0]
            inside[turn][:down], inside[turn][:, :right] = False, False
            corners += 1
    framed = np.logical_and.outer(inside.any(axis=1), inside.any(axis=0)) & (corners > 1)
    return np.asarray(framed[EDGE_PX:-EDGE_PX, EDGE_PX:-EDGE_PX])


def _within_corner(always: Array, ever: Array) -> Array:
    """Return the changing part right of and below each pixel; 0 unless nearly all left and above it rests.

    It is the least along both edges and in the corner itself, as a disc has none.
    """

    def mean(part: Array, down: int, right: int, high: int, wide: int) -> Array:
        return np.roll(cv2.blur(part, (wide, high), anchor=(0, 0)), (-down, -right), (0, 1))

    within = [mean(always, 2, 2, *size) for size in ((EDGE_PX, 2), (2, EDGE_PX), (3, 3))]
    beyond = mean(ever, 2, -3, EDGE_PX, 2), mean(ever, -3, 2, 2, EDGE_PX)
    return np.asarray(np.where(np.max(beyond, axis=0) < 0.1, np.min(within, axis=0), 0))
