"""How well two layers of a panorama fit where they overlap, before blending, and where things show twice."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np
from msgspec import Struct

from reconstruction.common.brightness import gain_and_bias
from reconstruction.common.drawing import LOST
from reconstruction.common.geometry import Array
from reconstruction.common.point_tracking import track_there_and_back
from reconstruction.panorama.composition import Box, Layer, average_layers, part_of

MIN_OVERLAP_PX = 500
LEAST_GRADIENT = 2.5
"""Grey levels a px in every direction; a window with less has nothing to hold on to (sky, a blank wall)."""
WINDOW_PX = 21
"""Window in which a point is found again."""
SPACING_PX = 9
"""There is at most one point in a square so wide."""
REACH_PX = 48
"""How far around a point that tracking has lost its window is compared with every other."""
PATCH_PX = 11
MOST_ROWS = 1 << 14
LEAST_LIKENESS = 0.8
"""Normalized correlation of both patches; less is another thing."""
MOST_RETURN_PX = 0.5
"""Found again from there, a point must lie so near to where it began."""
GHOST_GREY = 30.0
"""Where two pictures differ by more grey levels than this, they are marked as a ghost."""


@dataclass(frozen=True)
class PictureMisfit:
    """Where points of the first picture lie in the second: pixels (n, 2) of `Overlap`, and how far off, px.

    NaN is a point that is not found again, or not back from there.
    """

    at: Array
    length: Array

    def of(self, mask: Array) -> Array:
        """Lengths at the points in a mask (bool) of the overlap, NaN included."""
        return np.asarray(self.length[mask[self.at[:, 1], self.at[:, 0]]])


def known(lengths: Array) -> Array:
    """Those that are not NaN."""
    return np.asarray(lengths[np.isfinite(lengths)])


@dataclass(frozen=True)
class Overlap:
    """Two layers in a box that both reach into: grey pictures, and which pixels both have (bool)."""

    box: Box
    first: Array
    second: Array
    both: Array

    def crop(self, pixels: Array, box: Box) -> Array:
        """The part of a layer's pixels, which lie in `box`, that the overlap has."""
        left, top, right, bottom = self.box
        return pixels[top - box[1] : bottom - box[1], left - box[0] : right - box[0]]

    def with_brightness_matched(self, still: Array) -> "Overlap":
        """The second picture (float32 then) as bright as the first is on what stands still (bool)."""
        second = self.second.astype(np.float32)
        gain, bias = gain_and_bias(self.first, np.where(self.both & still, second, np.float32(np.nan)))
        return replace(self, second=np.asarray(np.clip(gain * second + bias, 0, 255), np.float32))

    @property
    def difference(self) -> Array:
        """By how many grey levels the pictures differ (float32); 0 where only one has a pixel."""
        apart = np.abs(self.first - self.second.astype(np.float32))
        return np.asarray(np.where(self.both, apart, np.float32(0)))


def overlap_of(a: Layer, b: Layer) -> Overlap | None:
    """Where two layers (BGR) overlap, the outermost pixels left out; None where they hardly do."""
    low = np.maximum(a.box[:2], b.box[:2])
    high = np.minimum(a.box[2:], b.box[2:])
    if (high <= low).any():
        return None
    box = int(low[0]), int(low[1]), int(high[0]), int(high[1])
    empty = Overlap(box, *(np.zeros((0, 0)),) * 3)
    both = (empty.crop(a.seen, a.box) & empty.crop(b.seen, b.box)).astype(np.uint8)
    both = cv2.erode(both, np.ones((7, 7), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    if both.sum() < MIN_OVERLAP_PX:
        return None
    first, second = (
        np.asarray(cv2.cvtColor(np.ascontiguousarray(empty.crop(one.picture, one.box)), cv2.COLOR_BGR2GRAY))
        for one in (a, b)
    )
    return Overlap(box, first, second, np.asarray(both) > 0)


def measure_misfit(overlap: Overlap) -> PictureMisfit:
    """Find the first picture's points again in the second, and back from there (Lucas and Kanade)."""
    first, second = (
        np.where(overlap.both, picture, 0).astype(np.uint8) for picture in (overlap.first, overlap.second)
    )
    at = _points(first, overlap.both)
    if not len(at):
        return PictureMisfit(at, np.zeros(0))
    return PictureMisfit(at, _displacement(first, second, at, overlap.both))


def _points(picture: Array, allowed: Array) -> Array:
    """Pixels (n, 2; int) with structure in every direction (Shi and Tomasi), apart from each other."""
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
    ys, xs = np.nonzero(peaks & (gradient > LEAST_GRADIENT) & (inner > 0))
    return np.column_stack([xs, ys])


def _displacement(a: Array, b: Array, at: Array, both: Array) -> Array:
    """How far points (n, 2) of a lie from there in b, px; NaN where that does not hold both ways."""
    levels = int(np.clip(np.log2(min(a.shape) / (2 * WINDOW_PX)), 0, 4))
    there, drift = track_there_and_back(a, b, at, WINDOW_PX, levels)
    kept = drift < MOST_RETURN_PX
    kept &= _likeness(a, at, b, there) > LEAST_LIKENESS
    for lost in np.nonzero(~kept)[0]:
        found = _search(a, b, at[lost])
        if found is not None:
            there[lost], kept[lost] = found, True
    nearest = np.round(np.where(kept[:, None], there, 0)).astype(int)
    inside = ((nearest >= 0) & (nearest < both.shape[::-1])).all(1)
    kept &= inside & both[np.where(inside, nearest[:, 1], 0), np.where(inside, nearest[:, 0], 0)]
    return np.where(kept, np.linalg.norm(there - at, axis=1), np.nan)


def _search(a: Array, b: Array, at: Array) -> Array | None:
    """The place in b (2,) most like a point of a within reach, if that point is the one most like it in a."""
    there = _most_alike(a, at, b)
    back = None if there is None else _most_alike(b, there, a)
    return there if back is not None and np.abs(back - at).max() <= 1 else None


def _most_alike(picture: Array, at: Array, other: Array) -> Array | None:
    """The place (2,) in another picture, in a square around `at`, of the patch around `at`."""
    half = WINDOW_PX // 2
    low, high = np.maximum(at - REACH_PX - half, 0), at + REACH_PX + half + 1
    patch = picture[max(at[1] - half, 0) : at[1] + half + 1, max(at[0] - half, 0) : at[0] + half + 1]
    if patch.shape != (WINDOW_PX, WINDOW_PX):
        return None
    likeness = cv2.matchTemplate(other[low[1] : high[1], low[0] : high[0]], patch, cv2.TM_CCOEFF_NORMED)
    _, most, _, (x, y) = cv2.minMaxLoc(likeness)
    return low + np.array([x + half, y + half]) if most > LEAST_LIKENESS else None


def _likeness(a: Array, at_a: Array, b: Array, at_b: Array) -> Array:
    """Normalized correlation (n,) of the patches around pixels (n, 2) of two pictures."""
    one, other = _patches(a, at_a), _patches(b, at_b)
    power = np.sqrt((one**2).sum(1) * (other**2).sum(1))
    return np.asarray((one * other).sum(1) / np.maximum(power, 1e-6))


def _patches(picture: Array, at: Array) -> Array:
    """The pixels (n, PATCH_PX squared; float32) around places (n, 2), without their mean."""
    reach = np.arange(PATCH_PX, dtype=np.float32) - PATCH_PX // 2
    across, down = (grid.ravel() for grid in np.meshgrid(reach, reach))
    xs, ys = ((at[:, i, None] + grid).astype(np.float32) for i, grid in enumerate((across, down)))
    grey = picture.astype(np.float32)
    # Remapping takes no more rows than a short integer counts.
    parts = [slice(k, k + MOST_ROWS) for k in range(0, len(at), MOST_ROWS)]
    sampled = np.concatenate([cv2.remap(grey, xs[part], ys[part], cv2.INTER_LINEAR) for part in parts])
    return np.asarray(sampled - sampled.mean(1, keepdims=True))


class Misfit(Struct, frozen=True, kw_only=True):
    """How far off things lie in a second picture, at points with structure that are found there and back."""

    points: int
    lost: int
    """Points with structure that were not found again, or not back from there."""
    median_px: float | None = None
    """Px of the panorama; None where there are no points."""
    p95_px: float | None = None

    @classmethod
    def at_points(cls, lengths: Array) -> "Misfit":
        """Of lengths (n,), NaN where a point was not found again."""
        found = known(lengths)
        lost = len(lengths) - len(found)
        if not len(found):
            return cls(points=0, lost=lost)
        median, p95 = (float(value) for value in np.percentile(found, [50, 95]))
        return cls(points=len(found), lost=lost, median_px=median, p95_px=p95)


class OverlapScore(Struct, frozen=True, kw_only=True):
    """Misfit of two pictures where they overlap, before blending."""

    first: str
    second: str
    misfit: Misfit
    mover_misfit: Misfit | None = None
    """On what moves in the first picture; None where nothing is known to."""
    mad: float
    """Mean absolute difference of brightness, grey levels."""


class Overlaps:
    """Every two layers that overlap, judged; `movers` are masks (bool) as large as their layers."""

    def __init__(
        self,
        layers: Mapping[str, Layer],
        movers: Mapping[str, Array],
        canvas: Box,
        late: Collection[str] = (),
    ) -> None:
        """`late`: where some cameras are late in a condition, overlaps of one of these with another count."""
        self.scores: list[OverlapScore] = []
        self._lengths: list[Array] = []
        self._mover_lengths: list[Array] = []
        self._layers, self._canvas, self._late = layers, canvas, late
        left, top, right, bottom = canvas
        self._worst = np.zeros((bottom - top, right - left), np.float32)
        for a, b in combinations(layers, 2):
            overlap = overlap_of(layers[a], layers[b])
            if overlap is not None:
                everywhere = np.ones_like(overlap.both)
                self._judge(a, b, overlap.with_brightness_matched(everywhere), movers)

    @property
    def misfit(self) -> Misfit:
        """At the points of all overlaps that count."""
        return Misfit.at_points(np.concatenate([np.zeros(0), *self._lengths]))

    @property
    def mover_misfit(self) -> Misfit | None:
        """The same on what moves; None where nothing is known to."""
        return Misfit.at_points(np.concatenate(self._mover_lengths)) if self._mover_lengths else None

    def marked(self) -> Array:
        """The mean of the layers, paler (BGR), with ghosts marked."""
        mean, count = average_layers(list(self._layers.values()), self._canvas)
        grey = cv2.cvtColor(cv2.cvtColor(mean, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
        picture = (0.35 * 255 + 0.55 * grey).astype(np.uint8)
        picture[count == 0] = 0
        picture[cv2.GaussianBlur(self._worst, (0, 0), 2) > GHOST_GREY] = LOST
        return np.asarray(picture)

    def _judge(self, a: str, b: str, overlap: Overlap, movers: Mapping[str, Array]) -> None:
        moving = overlap.crop(movers[a], self._layers[a].box) if a in movers else None
        found = measure_misfit(overlap)
        counts = not self._late or (a in self._late) != (b in self._late)
        if counts:
            self._lengths.append(found.length)
        on_movers = None
        if moving is not None:
            on_movers = Misfit.at_points(found.of(moving))
            if counts:
                self._mover_lengths.append(found.of(moving))
        difference = overlap.difference
        part = part_of(overlap.box, self._canvas)
        self._worst[part] = np.maximum(self._worst[part], difference)
        self.scores.append(
            OverlapScore(
                first=a,
                second=b,
                misfit=Misfit.at_points(found.length),
                mover_misfit=on_movers,
                mad=float(difference[overlap.both].mean()),
            )
        )
