"""What a condition is worth: on moving pixels, and beside them on still ones, which must not change."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from reconstruction.geometry import Array, View, other_from_reference
from reconstruction.movers import grow
from reconstruction.results import DepthScores
from reconstruction.stereo import DepthMap, StereoPair, noise_level

FEWEST_PIXELS = 30
"""Fewer moving pixels than this in an image tell nothing."""
PATCH_PX = 21
PATCHES = 40
ROWS_PX = 28
"""How far from its row a patch is looked for."""
LIKENESS = 0.75


@dataclass
class _Kind:
    pixels: int = 0
    covered: int = 0
    right: int = 0
    judged: int = 0
    differences: list[Array] = field(default_factory=list)
    rows: list[float] = field(default_factory=list)


class Tally:
    """Scores of one condition, added up over instants; every pixel counts the same."""

    def __init__(self) -> None:
        self._moving, self._static = _Kind(), _Kind()
        self._instants = 0

    def add(self, found: DepthMap, moving: Array, static: Array, truth: Array | None) -> None:
        """Count one instant: masks (bool) and true depth (calibration's unit, NaN = unknown)."""
        self._instants += 1
        for kind, mask in ((self._moving, moving), (self._static, static)):
            kind.pixels += int(mask.sum())
            kind.covered += int((found.depth[mask] > 0).sum())
            seen = found.difference[mask & np.isfinite(found.difference)]
            kind.differences.append(seen[:: max(1, len(seen) // 20000)])
            if truth is not None:
                known = mask & np.isfinite(truth)
                kind.judged += int(known.sum())
                kind.right += int(np.sum(np.abs(found.depth[known] - truth[known]) < 0.02 * truth[known]))

    def add_rows(self, moving: Sequence[float], static: Sequence[float]) -> None:
        """Add row errors (px) of patches on movers and on what stands still."""
        self._moving.rows += moving
        self._static.rows += static

    def scores(self) -> DepthScores:
        """The shares and medians over everything counted."""
        m, s = self._moving, self._static
        return DepthScores(
            mover_coverage=_share(m.covered, m.pixels),
            static_coverage=_share(s.covered, s.pixels),
            mover_within_2pct=_share(m.right, m.judged),
            static_within_2pct=_share(s.right, s.judged),
            mover_epipolar_px=_median(m.rows),
            static_epipolar_px=_median(s.rows),
            mover_photometric=_median(np.concatenate(m.differences)) if m.differences else None,
            static_photometric=_median(np.concatenate(s.differences)) if s.differences else None,
            instants=self._instants,
        )


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _median(values: Sequence[float] | Array) -> float | None:
    return float(np.median(values)) if len(values) else None


def still_depth(depths: Sequence[Array], moving: Sequence[Array]) -> Array:
    """Depth of what stands still: the median over the instants at which a pixel does not move; 0 = never."""
    stack = np.stack(
        [np.where((depth > 0) & ~mask, depth, np.nan) for depth, mask in zip(depths, moving, strict=True)]
    )
    known = np.isfinite(stack).any(0)
    result = np.zeros(stack.shape[1:], np.float32)
    result[known] = np.nanmedian(stack[:, known], axis=0)
    return result


def seen_through(reference: View, other: View, depth: Array) -> tuple[Array, Array]:
    """For each reference pixel, where a point at this depth lies in the other view.

    Returns float32 maps (height, width, 2), px; and whether it lies in the picture (bool). Pixels of
    unknown depth (0) take the nearest known one's.
    """
    unknown = (depth <= 0).astype(np.uint8)
    if unknown.all():
        return np.zeros((*depth.shape, 2), np.float32), np.zeros(depth.shape, bool)
    if unknown.any():
        _, labels = cv2.distanceTransformWithLabels(unknown, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
        nearest = np.zeros(int(labels.max()) + 1, np.float32)
        nearest[labels[unknown == 0]] = depth[unknown == 0]
        depth = nearest[labels]
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
