"""Depth against true depth: pixels that are right, and still pixels that serve as control."""

from collections.abc import Sequence

import cv2
import numpy as np
from msgspec import Struct

from reconstruction.common.geometry import Array, View, other_from_reference
from reconstruction.scene.moving_pixels import dilate

DEPTH_TOLERANCE = 0.02
"""Maximum relative error of a depth that counts as right."""
TOLERANCE_TEXT = f"within {100 * DEPTH_TOLERANCE:g} %"
TOLERANCES = {"within_1pct": 0.01, "within_2pct": DEPTH_TOLERANCE, "within_5pct": 0.05}
"""Relative tolerances by measure of `metrics.json`."""


def right_depth(depth: Array, truth: Array, tolerance: float = DEPTH_TOLERANCE) -> Array:
    """Return where depth is right (bool); false where depth or true depth is unknown (0 or not finite)."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(depth - truth) < tolerance * truth)


def fraction_right(depth: Array, truth: Array, mask: Array | None = None) -> float | None:
    """Return the fraction of right depths in a mask (bool); None if no true depth is known there (0)."""
    known = truth > 0 if mask is None else (truth > 0) & mask
    return float(right_depth(depth, truth)[known].mean()) if known.any() else None


class DepthShares(Struct, frozen=True, kw_only=True):
    """Accuracy of a depth map over pixels of known true depth; pixels without depth count as wrong."""

    within_2pct: float | None = None
    mover_within_2pct: float | None = None
    static_within_2pct: float | None = None
    median_error_pct: float | None = None
    """Median relative error of the depths found, percent."""


def depth_shares(depth: Array, truth: Array, moving: Array) -> dict[str, float | None]:
    """Return a depth map's scores by name, given true depth (0 = unknown) and a motion mask.

    They are the fractions within 2 % (of all, moving and static pixels), the coverage of moving pixels and
    the median error in %; None where nothing can be compared. All three arrays are height x width.
    """
    known, there = truth > 0, (depth > 0) & (truth > 0)
    error = np.abs(depth - truth)[there] / truth[there]
    on_moving = known & moving
    shares = {
        "within_2pct": fraction_right(depth, truth),
        "mover_within_2pct": fraction_right(depth, truth, moving),
        "static_within_2pct": fraction_right(depth, truth, ~moving),
        "mover_coverage": float(there[on_moving].mean()) if on_moving.any() else None,
        "median_error_pct": 100 * float(np.median(error)) if error.size else None,
    }
    return {name: None if fraction is None else round(fraction, 4) for name, fraction in shares.items()}


def true_depth_in_unit(truth: Array, unit: str, still: Array, static: Array) -> Array | None:
    """Return true depth (m, 0 = unknown) in the calibration's unit; NaN = unknown.

    Structure from motion has no metric scale. There, still pixels (`static`, bool) give the scale by their
    depth `still` (0 = unknown). None if no such depth is known.
    """
    known = np.where(truth > 0, truth, np.nan)
    if unit == "m":
        return known
    both = static & (still > 0) & np.isfinite(known)
    return known * float(np.median(still[both] / known[both])) if both.any() else None


def median_still_depth(depths: Sequence[Array], moving: Sequence[Array]) -> Array:
    """Return the still scene's depth: the median over the instants at which a pixel is still; 0 = never."""
    stack = np.stack(
        [np.where((depth > 0) & ~mask, depth, np.nan) for depth, mask in zip(depths, moving, strict=True)]
    )
    known = np.isfinite(stack).any(0)
    result = np.zeros(stack.shape[1:], np.float32)
    result[known] = np.nanmedian(stack[:, known], axis=0)
    return result


def fill_from_nearest(depth: Array) -> Array:
    """Return depth with unknown pixels (0) filled from the nearest known one; at least one must be known."""
    unknown = (depth <= 0).astype(np.uint8)
    if not unknown.any():
        return depth
    _, labels = cv2.distanceTransformWithLabels(unknown, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    nearest = np.zeros(int(labels.max()) + 1, np.float32)
    nearest[labels[unknown == 0]] = depth[unknown == 0]
    return np.asarray(nearest[labels])


def project_into_other(reference: View, other: View, depth: Array) -> tuple[Array, Array]:
    """Project each reference pixel at its depth into the other view.

    Returns float32 maps (height, width, 2), px, and whether the projection is inside the image (bool). Pixels
    of unknown depth (0) use the nearest known depth.
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
    where: Array, inside: Array, reference_moving: Sequence[Array], other_moving: Sequence[Array]
) -> Array:
    """Return the control (bool): pixels that no moving object can affect, equal in both conditions.

    No moving region may touch the pixel itself at any of the times. Nor may one touch its projection in the
    other view (`where`, from `project_into_other`).
    """
    here = dilate(np.logical_or.reduce(list(reference_moving)), 4)
    there = dilate(np.logical_or.reduce(list(other_moving)), 8).astype(np.uint8)
    return np.asarray(inside & ~here & (cv2.remap(there, where, None, cv2.INTER_NEAREST) == 0))
