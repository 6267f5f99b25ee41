"""Where a condition is judged: on moving pixels, and beside them on still ones, which must not change."""

from collections.abc import Sequence

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View, other_from_reference
from reconstruction.session.movers import grow
from reconstruction.stereo.stereo import StereoPair, noise_level

FEWEST_PIXELS = 30
"""Fewer moving pixels than this in an image tell nothing."""
PATCH_PX = 21
PATCHES = 40
ROWS_PX = 28
"""How far from its row a patch is looked for."""
LIKENESS = 0.75


def still_depth(depths: Sequence[Array], moving: Sequence[Array]) -> Array:
    """Depth of what stands still: the median over the instants at which a pixel does not move; 0 = never."""
    stack = np.stack(
        [np.where((depth > 0) & ~mask, depth, np.nan) for depth, mask in zip(depths, moving, strict=True)]
    )
    known = np.isfinite(stack).any(0)
    result = np.zeros(stack.shape[1:], np.float32)
    result[known] = np.nanmedian(stack[:, known], axis=0)
    return result


def without_holes(depth: Array) -> Array:
    """Depth with the nearest known pixel's value where it is unknown (0); some must be known."""
    unknown = (depth <= 0).astype(np.uint8)
    if not unknown.any():
        return depth
    _, labels = cv2.distanceTransformWithLabels(unknown, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    nearest = np.zeros(int(labels.max()) + 1, np.float32)
    nearest[labels[unknown == 0]] = depth[unknown == 0]
    return np.asarray(nearest[labels])


def seen_through(reference: View, other: View, depth: Array) -> tuple[Array, Array]:
    """For each reference pixel, where a point at this depth lies in the other view.

    Returns float32 maps (height, width, 2), px; and whether it lies in the picture (bool). Pixels of
    unknown depth (0) take the nearest known one's.
    """
    if not (depth > 0).any():
        return np.zeros((*depth.shape, 2), np.float32), np.zeros(depth.shape, bool)
    depth = without_holes(depth)
    points = reference.rays(reference.grid()) * depth.reshape(-1, 1)
    rotation, translation = other_from_reference(reference, other)
    moved = points @ rotation.T + translation
    front = moved[:, 2] > 1e-9
    moved[~front] = (0, 0, 1)
    pixels, _ = cv2.projectPoints(moved, np.zeros(3), np.zeros(3), other.matrix, other.distortion)
    pixels = pixels.reshape(*depth.shape, 2)
    inside = (pixels > 0).all(2) & (pixels < (other.width - 1, other.height - 1)).all(2)
    return pixels.astype(np.float32), inside & front.reshape(depth.shape)


def still_control(
    where: Array, inside: Array, reference_movers: Sequence[Array], other_movers: Sequence[Array]
) -> Array:
    """Pixels on which no mover can have a hand (bool): the control that must be equal in both conditions.

    Neither the pixel nor the place in the other view at which its still point is seen (`where`, from
    `seen_through`) is touched by a mover, at any of the times.
    """
    here = grow(np.logical_or.reduce(list(reference_movers)), 4)
    there = grow(np.logical_or.reduce(list(other_movers)), 8).astype(np.uint8)
    hidden = cv2.remap(there, where, None, cv2.INTER_NEAREST) > 0
    return np.asarray(inside & ~here & ~hidden)


def in_unit(truth: Array, unit: str, still: Array, static: Array) -> Array | None:
    """True depth (m, 0 or not finite = unknown) in the calibration's unit, NaN = unknown.

    Structure from motion knows no metres: there, what stands still (`static`, bool) gives the scale by its
    depth `still` (0 = unknown). None where none of that is known.
    """
    known = np.where(np.isfinite(truth) & (truth > 0), truth, np.nan)
    if unit == "m":
        return known
    both = static & (still > 0) & np.isfinite(known)
    return known * float(np.median(still[both] / known[both])) if both.any() else None


def row_errors(pair: StereoPair, reference: Array, other: Array, mask: Array) -> list[float]:
    """How far matched patches on a mask lie from their row, px of the rectified pictures.

    Patches of the reference (grey, uint8) are looked for freely in two dimensions; only sure finds count.
    """
    canvas = pair.rectification
    a, _ = canvas.remap(reference)
    b, seen = canvas.remap(other, other=True)
    on, _ = canvas.remap(mask.astype(np.uint8), nearest=True)
    half = PATCH_PX // 2
    ys, xs = np.nonzero(on)
    inside = (xs >= half) & (xs < a.shape[1] - half) & (ys >= half) & (ys < a.shape[0] - half)
    ys, xs = ys[inside], xs[inside]
    if len(ys) < FEWEST_PIXELS:
        return []
    least = 4 * noise_level(a) + 2
    errors = []
    for i in np.linspace(0, len(ys) - 1, PATCHES).astype(int):
        x, y = int(xs[i]), int(ys[i])
        patch = a[y - half : y + half + 1, x - half : x + half + 1]
        if patch.std() < least:
            continue
        left = max(0, x - pair.low - pair.count - half)
        right = min(b.shape[1], x - pair.low + half + 1)
        top, bottom = max(0, y - half - ROWS_PX), min(b.shape[0], y + half + 1 + ROWS_PX)
        strip = b[top:bottom, left:right]
        if min(strip.shape) < PATCH_PX or not seen[y, left:right].any():
            continue
        likeness = cv2.matchTemplate(strip, patch, cv2.TM_CCOEFF_NORMED)
        _, best, _, at = cv2.minMaxLoc(likeness)
        if best >= LIKENESS and 0 < at[1] < likeness.shape[0] - 1:
            errors.append(abs(at[1] + _peak(likeness[at[1] - 1 : at[1] + 2, at[0]]) + top + half - y))
    return errors


def _peak(values: Array) -> float:
    """Offset of a parabola's top from the middle of three values, in -0.5..0.5."""
    low, middle, high = (float(value) for value in values)
    bend = low - 2 * middle + high
    return 0.0 if bend >= 0 else float(np.clip(0.5 * (low - high) / bend, -0.5, 0.5))
