"""Where a panorama shows what moved twice: its pictures, warped one by one, differ where they overlap."""

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import cv2
import numpy as np
from msgspec import Struct

from reconstruction.common.brightness import match_brightness
from reconstruction.common.drawing import LOST
from reconstruction.common.geometry import Array
from reconstruction.panorama.optical_flow import dense_flow

MIN_OVERLAP_PX = 500
GHOST_GREY = 30.0
"""Where two pictures differ by more grey levels than this, they are marked as a ghost."""


class OverlapScore(Struct, frozen=True, kw_only=True):
    """Misfit of two pictures where they overlap, before blending."""

    first: str
    second: str
    flow_p95_px: float
    """Displacement that 95 % of the pixels do not exceed, by dense optical flow, px of the pictures."""
    mad: float
    """Mean absolute difference of brightness, grey levels."""


def all_seen(image: Array) -> Array:
    """A mask (uint8, 255) of a picture's size."""
    return np.full(image.shape[:2], 255, np.uint8)


def mark_ghosts(
    stitcher: Any, names: Sequence[str], pictures: Sequence[Array]
) -> tuple[Array, list[OverlapScore]]:
    """The mean of a panorama's pictures, paler (BGR), with ghosts marked; and the overlaps it was judged by.

    `stitcher` is OpenCV's, registered; `pictures` (BGR) are those that it composes, with their names.
    """
    layers, scale = _warp_separately(stitcher, pictures)
    shape = layers[0][0].shape
    worst = np.zeros(shape, np.float32)
    overlaps = []
    for (i, a), (j, b) in combinations(enumerate(layers), 2):
        both = cv2.erode((a[1] & b[1]).astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
        if both.sum() < MIN_OVERLAP_PX:
            continue
        matched = match_brightness(a[0], np.where(both, b[0], np.nan).astype(np.float32))
        difference = np.where(both, np.abs(a[0] - matched), 0)
        rows, columns = (np.nonzero(both.any(axis))[0] for axis in (1, 0))
        part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        filled = np.where(both, matched, a[0])
        length = np.linalg.norm(dense_flow(a[0][part], filled[part]), axis=2)[both[part]]
        worst = np.maximum(worst, difference)
        overlaps.append(
            OverlapScore(
                first=names[i],
                second=names[j],
                flow_p95_px=float(np.percentile(length, 95)) / scale,
                mad=float(difference[both].mean()),
            )
        )
    seen_by = np.sum([mask for _, mask in layers], axis=0)
    mean = np.sum([canvas * mask for canvas, mask in layers], axis=0) / np.maximum(seen_by, 1)
    ghosts = cv2.cvtColor((0.35 * 255 + 0.55 * mean).astype(np.uint8), cv2.COLOR_GRAY2BGR)
    ghosts[seen_by == 0] = 0
    ghosts[cv2.GaussianBlur(worst, (0, 0), 2) > GHOST_GREY] = LOST
    return np.asarray(ghosts), overlaps


def _warp_separately(stitcher: Any, pictures: Sequence[Array]) -> tuple[list[tuple[Array, Array]], float]:
    """Each picture (grey) and where it lies (bool) on one canvas; and the canvas's scale."""
    scale = float(stitcher.workScale())
    cameras = stitcher.cameras()
    focal = float(np.median([camera.focal for camera in cameras]))
    warper = cv2.PyRotationWarper("spherical", focal)
    warped = []
    for image, camera in zip(pictures, cameras, strict=True):
        size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
        matrix, turn = camera.K().astype(np.float32), np.asarray(camera.R, np.float32)
        grey = cv2.cvtColor(cv2.resize(image, size, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
        corner, picture = warper.warp(grey, matrix, turn, cv2.INTER_LINEAR, cv2.BORDER_REFLECT)
        _, seen = warper.warp(all_seen(grey), matrix, turn, cv2.INTER_NEAREST, cv2.BORDER_CONSTANT)
        warped.append((corner, np.asarray(picture), np.asarray(seen) > 0))
    left, top = (min(corner[i] for corner, _, _ in warped) for i in (0, 1))
    width = max(corner[0] + picture.shape[1] for corner, picture, _ in warped) - left
    height = max(corner[1] + picture.shape[0] for corner, picture, _ in warped) - top
    layers = []
    for (x, y), picture, seen in warped:
        canvas, mask = np.zeros((height, width), np.float32), np.zeros((height, width), bool)
        part = slice(y - top, y - top + picture.shape[0]), slice(x - left, x - left + picture.shape[1])
        canvas[part], mask[part] = picture, seen
        layers.append((canvas, mask))
    return layers, scale
