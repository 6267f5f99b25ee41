"""What stands still, and the pixels that no mover can affect: the control of every comparison."""

from collections.abc import Sequence

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View, other_from_reference
from reconstruction.session.mover_detection import dilate


def median_still_depth(depths: Sequence[Array], moving: Sequence[Array]) -> Array:
    """Depth of what stands still: the median over the instants at which a pixel does not move; 0 = never."""
    stack = np.stack(
        [np.where((depth > 0) & ~mask, depth, np.nan) for depth, mask in zip(depths, moving, strict=True)]
    )
    known = np.isfinite(stack).any(0)
    result = np.zeros(stack.shape[1:], np.float32)
    result[known] = np.nanmedian(stack[:, known], axis=0)
    return result


def fill_from_nearest(depth: Array) -> Array:
    """Depth, with the nearest known pixel's where it is unknown (0); some must be known."""
    unknown = (depth <= 0).astype(np.uint8)
    if not unknown.any():
        return depth
    _, labels = cv2.distanceTransformWithLabels(unknown, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    nearest = np.zeros(int(labels.max()) + 1, np.float32)
    nearest[labels[unknown == 0]] = depth[unknown == 0]
    return np.asarray(nearest[labels])


def project_into_other(reference: View, other: View, depth: Array) -> tuple[Array, Array]:
    """For each reference pixel, where a point at this depth lies in the other view.

    Returns float32 maps (height, width, 2), px; and whether it lies in the picture (bool). Pixels of
    unknown depth (0) take the nearest known one's.
    """
    if not (depth > 0).any():
        return np.zeros((*depth.shape, 2), np.float32), np.zeros(depth.shape, bool)
    depth = fill_from_nearest(depth)
    points = reference.rays(reference.grid()) * depth.reshape(-1, 1)
    rotation, translation = other_from_reference(reference, other)
    moved = points @ rotation.T + translation
    front = moved[:, 2] > 1e-9
    moved[~front] = (0, 0, 1)
    pixels = other.project(moved).reshape(*depth.shape, 2)
    inside = (pixels > 0).all(2) & (pixels < (other.width - 1, other.height - 1)).all(2)
    return pixels.astype(np.float32), inside & front.reshape(depth.shape)


def still_pixels(
    where: Array, inside: Array, reference_movers: Sequence[Array], other_movers: Sequence[Array]
) -> Array:
    """Pixels that no moving object can affect (bool): the control that must be equal in both conditions.

    Neither the pixel nor the place in the other view at which its still point is seen (`where`, from
    `project_into_other`) is touched by a mover, at any of the times.
    """
    here = dilate(np.logical_or.reduce(list(reference_movers)), 4)
    there = dilate(np.logical_or.reduce(list(other_movers)), 8).astype(np.uint8)
    hidden = cv2.remap(there, where, None, cv2.INTER_NEAREST) > 0
    return np.asarray(inside & ~here & ~hidden)
