"""Registration residual of two overlapping panorama layers before blending, and ghosts."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np
from msgspec import Struct

from reconstruction.common.drawing import LOST
from reconstruction.common.geometry import Array
from reconstruction.common.image_matching import gain_and_bias, track_there_and_back
from reconstruction.methods.panorama.composition import Box, Layer, average_layers, part_of

MIN_OVERLAP_PX = 500
MIN_GRADIENT = 2.5
"""Minimum gradient in every direction, grey levels per px; flat windows (sky, a blank wall) have less."""
WINDOW_PX = 21
"""Window for tracking a point."""
SPACING_PX = 9
"""Side of the square that contains at most one point."""
SEARCH_PX = 48
"""Search radius around a point that tracking has lost; its window is matched exhaustively there."""
PATCH_PX = 11
MAX_ROWS = 1 << 14
MIN_LIKENESS = 0.8
"""Minimum normalized correlation of both patches."""
MAX_RETURN_PX = 0.5
"""Maximum distance of a point, tracked forward and back, from its start."""
GHOST_GREY = 30.0
"""Difference in grey levels from which two images are marked as a ghost."""


def known(lengths: Array) -> Array:
    """Return the values that are not NaN."""
    return np.asarray(lengths[np.isfinite(lengths)])


@dataclass(frozen=True)
class Overlap:
    """Two layers in the box that both reach: grey images, and the pixels that both cover (bool)."""

    box: Box
    first: Array
    second: Array
    both: Array

    def crop(self, pixels: Array, box: Box) -> Array:
        """Crop a layer's pixels, which cover `box`, to the overlap."""
        left, top, right, bottom = self.box
        return pixels[top - box[1] : bottom - box[1], left - box[0] : right - box[0]]

    def with_brightness_matched(self) -> "Overlap":
        """Return the overlap with the second image (float32) as bright as the first."""
        second = self.second.astype(np.float32)
        gain, bias = gain_and_bias(self.first, np.where(self.both, second, np.float32(np.nan)))
        return replace(self, second=np.asarray(np.clip(gain * second + bias, 0, 255), np.float32))

    @property
    def difference(self) -> Array:
        """Absolute grey-level difference of the images (float32); 0 where only one covers the pixel."""
        return np.asarray(np.abs(self.first - self.second.astype(np.float32)) * self.both)


def overlap_of(a: Layer, b: Layer) -> Overlap | None:
    """Return the overlap of two layers (BGR) without its outermost pixels; None if it is too small."""
    left, top = map(max, a.box[:2], b.box[:2])
    right, bottom = map(min, a.box[2:], b.box[2:])
    if right <= left or bottom <= top:
        return None
    empty = Overlap((left, top, right, bottom), *(np.zeros((0, 0)),) * 3)
    both = (empty.crop(a.seen, a.box) & empty.crop(b.seen, b.box)).astype(np.uint8)
    both = cv2.erode(both, np.ones((7, 7), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    if both.sum() < MIN_OVERLAP_PX:
        return None
    first, second = (
        np.asarray(
            cv2.cvtColor(np.ascontiguousarray(empty.crop(image.picture, image.box)), cv2.COLOR_BGR2GRAY)
        )
        for image in (a, b)
    )
    return replace(empty, first=first, second=second, both=np.asarray(both) > 0)


def measure_misalignment(overlap: Overlap) -> tuple[Array, Array]:
    """Track the first image's points into the second and back (Lucas and Kanade).

    Returns the points' x and y (2, n; int) in the overlap, and the lengths (n,) of their displacements, px. A
    length is NaN if tracking failed in either direction.
    """
    first, second = (
        np.where(overlap.both, picture, 0).astype(np.uint8) for picture in (overlap.first, overlap.second)
    )
    at = _points(first, overlap.both)
    return at.T, _displacement(first, second, at, overlap.both) if len(at) else np.zeros(0)


def _points(picture: Array, allowed: Array) -> Array:
    """Return spaced pixels (n, 2; int) with structure in every direction (Shi and Tomasi)."""
    inner = cv2.erode(
        allowed.astype(np.uint8),
        np.ones((WINDOW_PX, WINDOW_PX), np.uint8),
        borderType=cv2.BORDER_CONSTANT,
        borderValue=0,
    )
    smooth = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 1.0)
    # The eigenvalue of a 7 px block is four times the square of the gradient.
    gradient = np.sqrt(np.maximum(cv2.cornerMinEigenVal(smooth, 7, ksize=3), 0) / 4)
    peaks = gradient == cv2.dilate(gradient, np.ones((SPACING_PX, SPACING_PX), np.uint8))
    ys, xs = np.nonzero(peaks & (gradient > MIN_GRADIENT) & (inner > 0))
    return np.column_stack([xs, ys])


def _displacement(a: Array, b: Array, at: Array, both: Array) -> Array:
    """Return the displacement of points (n, 2) from a to b, px; NaN if it fails in either direction."""
    levels = int(np.clip(np.log2(min(a.shape) / (2 * WINDOW_PX)), 0, 4))
    there, drift = track_there_and_back(a, b, at, WINDOW_PX, levels)
    tracked = (drift < MAX_RETURN_PX) & (_likeness(a, at, b, there) > MIN_LIKENESS)
    for lost in np.nonzero(~tracked)[0]:
        if (places := _search(a, b, at[lost])) is not None:
            there[lost], tracked[lost] = places, True
    nearest = np.round(np.where(tracked[:, None], there, 0)).astype(int)
    inside = ((nearest >= 0) & (nearest < both.shape[::-1])).all(1)
    tracked &= inside & both[np.where(inside, nearest[:, 1], 0), np.where(inside, nearest[:, 0], 0)]
    return np.where(tracked, np.linalg.norm(there - at, axis=1), np.nan)


def _search(a: Array, b: Array, at: Array) -> Array | None:
    """Return the place (2,) in image b that matches the place `at` in image a, near it; None without.

    The match must be mutual, to within a pixel.
    """
    there = _best_match(a, at, b)
    back = None if there is None else _best_match(b, there, a)
    return there if back is not None and np.abs(back - at).max() <= 1 else None


def _best_match(picture: Array, at: Array, other: Array) -> Array | None:
    """Return the best match (2,), in a square around `at` of another image, for the patch around `at`."""
    half = WINDOW_PX // 2
    low, high = np.maximum(at - SEARCH_PX - half, 0), at + SEARCH_PX + half + 1
    patch = picture[max(at[1] - half, 0) : at[1] + half + 1, max(at[0] - half, 0) : at[0] + half + 1]
    if patch.shape != (WINDOW_PX, WINDOW_PX):
        return None
    likeness = cv2.matchTemplate(other[low[1] : high[1], low[0] : high[0]], patch, cv2.TM_CCOEFF_NORMED)
    _, best, _, (x, y) = cv2.minMaxLoc(likeness)
    return low + np.array([x + half, y + half]) if best > MIN_LIKENESS else None


def _likeness(a: Array, at_a: Array, b: Array, at_b: Array) -> Array:
    """Return the normalized correlation (n,) of the patches around pixels (n, 2) of two images."""
    first, other = _patches(a, at_a), _patches(b, at_b)
    return np.asarray(
        (first * other).sum(1) / np.maximum(np.sqrt((first**2).sum(1) * (other**2).sum(1)), 1e-6)
    )


def _patches(picture: Array, at: Array) -> Array:
    """Return zero-mean patches (n, PATCH_PX squared; float32) around points (n, 2)."""
    offsets = np.arange(PATCH_PX, dtype=np.float32) - PATCH_PX // 2
    across, down = (grid.ravel() for grid in np.meshgrid(offsets, offsets))
    xs, ys = ((at[:, i, None] + grid).astype(np.float32) for i, grid in enumerate((across, down)))
    grey = picture.astype(np.float32)
    # Remapping is limited to the number of rows that a short integer can count.
    parts = [slice(k, k + MAX_ROWS) for k in range(0, len(at), MAX_ROWS)]
    sampled = np.concatenate([cv2.remap(grey, xs[part], ys[part], cv2.INTER_LINEAR) for part in parts])
    return np.asarray(sampled - sampled.mean(1, keepdims=True))


class Misalignment(Struct, frozen=True, kw_only=True):
    """Residual in a second image, at structured points that are tracked there and back."""

    points: int
    lost: int
    """Structured points for which tracking failed in either direction."""
    median_px: float | None = None
    """Median in px of the panorama; None if there are no points."""
    p95_px: float | None = None

    @classmethod
    def at_points(cls, lengths: Array) -> "Misalignment":
        """Summarize lengths (n,), NaN where a point was lost."""
        lengths_px = known(lengths)
        median, p95 = map(float, np.percentile(lengths_px, [50, 95])) if len(lengths_px) else (None, None)
        return cls(points=len(lengths_px), lost=len(lengths) - len(lengths_px), median_px=median, p95_px=p95)


class OverlapScore(Struct, frozen=True, kw_only=True):
    """Residual of two images in their overlap, before blending."""

    first: str
    second: str
    misfit: Misalignment
    mover_misfit: Misalignment | None = None
    """Residual on what moves in the first image; None if motion is unknown."""
    mad: float
    """Mean absolute brightness difference, grey levels."""


def score_overlaps(
    layers: Mapping[str, Layer], moving_masks: Mapping[str, Array], canvas: Box, late: Collection[str] = ()
) -> tuple[tuple[OverlapScore, ...], Misalignment, Misalignment | None, Array]:
    """Measure all overlaps; with delayed cameras in `late`, only their overlaps with others count.

    `moving_masks` are motion masks (bool) of the layers' sizes. Returns the residual of each overlap, at the
    points of all overlaps that count, and on moving objects in these (None if motion is unknown); and the
    lightened mean of the layers (BGR) with ghosts marked.
    """
    scores: list[OverlapScore] = []
    lengths, moving_lengths = [np.zeros(0)], []
    left, top, right, bottom = canvas
    worst = np.zeros((bottom - top, right - left), np.float32)
    for a, b in combinations(layers, 2):
        if (overlap := overlap_of(layers[a], layers[b])) is None:
            continue
        overlap = overlap.with_brightness_matched()
        (x, y), length = measure_misalignment(overlap)
        moving = [length[overlap.crop(moving_masks[a], layers[a].box)[y, x]]] if a in moving_masks else []
        if not late or (a in late) != (b in late):
            lengths.append(length)
            moving_lengths += moving
        part, difference = part_of(overlap.box, canvas), overlap.difference
        worst[part] = np.maximum(worst[part], difference)
        scores.append(
            OverlapScore(
                first=a,
                second=b,
                misfit=Misalignment.at_points(length),
                mover_misfit=Misalignment.at_points(moving[0]) if moving else None,
                mad=float(difference[overlap.both].mean()),
            )
        )
    return (
        tuple(scores),
        Misalignment.at_points(np.concatenate(lengths)),
        Misalignment.at_points(np.concatenate(moving_lengths)) if moving_lengths else None,
        _mark_ghosts(list(layers.values()), canvas, worst),
    )


def _mark_ghosts(layers: Sequence[Layer], canvas: Box, difference: Array) -> Array:
    """Return the lightened mean of layers (BGR), with places of great `difference` marked."""
    mean, count = average_layers(layers, canvas)
    grey = cv2.cvtColor(cv2.cvtColor(mean, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    picture = (0.35 * 255 + 0.55 * grey).astype(np.uint8)
    picture[count == 0] = 0
    picture[cv2.GaussianBlur(difference, (0, 0), 2) > GHOST_GREY] = LOST
    return np.asarray(picture)
