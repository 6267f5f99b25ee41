"""What a condition is worth, counted instant by instant, with intervals over the instants."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from reconstruction.geometry import Array
from reconstruction.intervals import interval, pooled_samples, share_samples
from reconstruction.results import DepthScores, Interval
from reconstruction.stereo import DepthMap

KINDS = ("mover", "static")
MEASURES = ("coverage", "within_2pct", "epipolar_px", "photometric")
MOST_DIFFERENCES = 20000
FEWEST_FOR_INTERVAL = 3
"""Fewer instants than this say nothing about how instants differ."""


@dataclass
class _Count:
    """One kind of pixels of one instant."""

    pixels: int
    covered: int
    judged: int = 0
    right: int = 0
    differences: Array = field(default_factory=lambda: np.zeros(0))
    rows: Array = field(default_factory=lambda: np.zeros(0))


class Tally:
    """Scores of one condition, added up over instants; every pixel counts the same."""

    def __init__(self) -> None:
        self._counts: dict[str, list[_Count]] = {kind: [] for kind in KINDS}

    def add(self, found: DepthMap, moving: Array, static: Array, truth: Array | None) -> None:
        """Count one instant: masks (bool) and true depth (calibration's unit, NaN = unknown)."""
        for kind, mask in zip(KINDS, (moving, static), strict=True):
            seen = found.difference[mask & np.isfinite(found.difference)]
            count = _Count(int(mask.sum()), int((found.depth[mask] > 0).sum()))
            count.differences = seen[:: max(1, len(seen) // MOST_DIFFERENCES)]
            if truth is not None:
                known = mask & np.isfinite(truth)
                count.judged = int(known.sum())
                count.right = int(np.sum(np.abs(found.depth[known] - truth[known]) < 0.02 * truth[known]))
            self._counts[kind].append(count)

    def add_rows(self, moving: Sequence[float], static: Sequence[float]) -> None:
        """Add row errors (px) of patches on movers and on what stands still, of the instant added last."""
        for kind, rows in zip(KINDS, (moving, static), strict=True):
            self._counts[kind][-1].rows = np.array(rows, float)

    @property
    def instants(self) -> int:
        """How many instants were added."""
        return len(self._counts["mover"])

    def value(self, kind: str, measure: str) -> float | None:
        """A measure over everything counted; None where there is nothing to measure."""
        counts = self._counts[kind]
        if measure in ("coverage", "within_2pct"):
            parts, wholes = self._shares(kind, measure)
            return float(parts.sum() / wholes.sum()) if wholes.sum() else None
        pooled = np.concatenate([_values(count, measure) for count in counts]) if counts else np.zeros(0)
        return float(np.median(pooled)) if len(pooled) else None

    def samples(self, kind: str, measure: str) -> Array:
        """The measure of every bootstrap draw of the instants; draws of two tallies belong together."""
        if self.instants < FEWEST_FOR_INTERVAL:
            return np.zeros(0)
        if measure in ("coverage", "within_2pct"):
            return share_samples(*self._shares(kind, measure))
        thinned = [_values(count, measure) for count in self._counts[kind]]
        return pooled_samples([v[:: max(1, len(v) // 400)] for v in thinned], lambda v: float(np.median(v)))

    def interval(self, kind: str, measure: str) -> Interval | None:
        """The measure with its interval over the instants."""
        return interval(self.value(kind, measure), self.samples(kind, measure))

    def scores(self, *, intervals: bool = False) -> DepthScores:
        """The shares and medians over everything counted."""
        values = {f"{kind}_{measure}": self.value(kind, measure) for kind in KINDS for measure in MEASURES}
        known = {}
        if intervals:
            found = {f"{kind}_{m}": self.interval(kind, m) for kind in KINDS for m in MEASURES}
            known = {name: one for name, one in found.items() if one is not None}
        return DepthScores(**values, intervals=known, instants=self.instants)

    def _shares(self, kind: str, measure: str) -> tuple[Array, Array]:
        counts = self._counts[kind]
        if measure == "coverage":
            return np.array([c.covered for c in counts]), np.array([c.pixels for c in counts])
        return np.array([c.right for c in counts]), np.array([c.judged for c in counts])


def differences(synced: Tally, other: Tally) -> dict[str, Interval]:
    """Other minus synced for every measure, paired by instant, with intervals."""
    found = {}
    for kind in KINDS:
        for measure in MEASURES:
            before, after = synced.value(kind, measure), other.value(kind, measure)
            if before is None or after is None or synced.instants != other.instants:
                continue
            drawn = other.samples(kind, measure) - synced.samples(kind, measure)
            one = interval(after - before, drawn)
            if one is not None:
                found[f"{kind}_{measure}"] = one
    return found


def _values(count: _Count, measure: str) -> Array:
    return count.rows if measure == "epipolar_px" else count.differences
