"""Where a panorama would show a thing twice: its layers differ where they overlap."""

from collections.abc import Collection, Mapping
from itertools import combinations

import cv2
import numpy as np
from msgspec import Struct

from reconstruction.common.drawing import LOST
from reconstruction.common.geometry import Array
from reconstruction.panorama.composition import average_layers
from reconstruction.panorama.overlap import Overlap, known, measure_misfit, overlap_of
from reconstruction.panorama.projection import Box, Layer, part_of

GHOST_GREY = 30.0
"""Where two pictures differ by more grey levels than this, they are marked as a ghost."""


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
