"""The time offset of two cameras that crossings of epipolar lines agree on, with its error bar."""

import math
from dataclasses import dataclass, replace

import numpy as np

from reconstruction.common.geometry import Array
from reconstruction.time_offsets.epipolar_crossings import Crossings

MATCH_PX = 0.5
"""Error of a match across its epipolar line, to begin with; then it is measured."""
LEAST_ACROSS_PX = 1.0
"""Points that cross their line by less within a frame tell nothing."""
BIN_MS = 0.25
NEAR_PX = 4.0
"""Matches that are further from what most agree on are wrong ones."""
LEAST_VOTES = 6.0
"""So many crossings must agree."""
DISTINCT = 1.6
"""And so many times as many as on any other offset: wrong matches agree on everything a little."""
MIN_POINTS = 3
"""Fewer points of an instant may all be wrong matches."""
MIN_INSTANTS = 3
"""With fewer instants there is no error bar that could be believed."""
SYSTEMATIC_MS = 0.25
"""What is left of rows, exposures and the paths between images; one standard deviation."""
RESAMPLES = 300


@dataclass(frozen=True)
class StillErrors:
    """Epipolar errors of what stands still, which no timing explains: median and spread (sd), px."""

    median_px: float = 0.0
    spread_px: float = 1.0

    @classmethod
    def of(cls, errors_px: Array) -> "StillErrors":
        """Of signed errors (n,); with few of them the calibration is taken to be right to a pixel."""
        kept = errors_px[np.abs(errors_px) < 6]
        if len(kept) < 20:
            return cls()
        middle = float(np.median(kept))
        return cls(middle, max(0.2, 1.4826 * float(np.median(np.abs(kept - middle)))))


@dataclass(frozen=True)
class InstantOffset:
    """The offset by one instant's image of the first camera alone; `points` is how many agree."""

    instant: int
    offset_ms: float
    sd_ms: float
    points: int


@dataclass(frozen=True)
class OffsetFit:
    """How late the second camera is against the first, and the same by each instant alone.

    `reason` says why it is not known; `offset_ms` and `sd_ms` are None then.
    """

    offset_ms: float | None = None
    sd_ms: float | None = None
    reason: str = ""
    instants: tuple[InstantOffset, ...] = ()
    votes: float = 0.0
    """About how many crossings agree."""

    def later(self, by_ms: float) -> "OffsetFit":
        """The same, of a second camera that is later by so much."""
        moved = tuple(replace(one, offset_ms=one.offset_ms + by_ms) for one in self.instants)
        offset_ms = None if self.offset_ms is None else self.offset_ms + by_ms
        return replace(self, offset_ms=offset_ms, instants=moved)

    def in_doubt_of(self, other: "OffsetFit") -> "OffsetFit":
        """The same, known no better than half of what another geometry of the pair moves it by."""
        if self.offset_ms is None or self.sd_ms is None or other.offset_ms is None:
            return self
        return replace(self, sd_ms=math.hypot(self.sd_ms, (self.offset_ms - other.offset_ms) / 2))


def fit_offset(crossings: Crossings, still: StillErrors, period_ms: float) -> OffsetFit:
    """The offset that most crossings agree on, refined by robust least squares; median over the instants.

    A calibration that is off moves all crossings by a constant distance, and so by a time that depends on how
    fast a point crosses its line: that distance is fitted too, and what stands still bounds it.
    """
    found = crossings.only(np.abs(crossings.across_px_per_ms) * period_ms > LEAST_ACROSS_PX)
    if len(found.offset_ms) < LEAST_VOTES:
        return OffsetFit(
            reason="both cameras recognize too few moving points, or these move along their epipolar lines"
        )
    peak, votes, rival = _most_agreed(found, period_ms)
    if votes < LEAST_VOTES or votes < DISTINCT * rival:
        return OffsetFit(reason="the points that move do not agree on one offset")
    misses = (found.offset_ms - peak) * found.across_px_per_ms
    near = found.only((np.abs(misses) < NEAR_PX) & (np.abs(found.offset_ms - peak) < period_ms))
    shift, match_px, fit_sd = _fit_line(near, still, peak)
    moved = near.offset_ms - shift / near.across_px_per_ms
    instants = _by_instant(near, moved, match_px, period_ms)
    if len(instants) < MIN_INSTANTS:
        return OffsetFit(
            reason=f"it takes {MIN_INSTANTS} instants at which it can be measured, not {len(instants)}",
            instants=instants,
        )
    values, sds = (np.array(of) for of in zip(*((one.offset_ms, one.sd_ms) for one in instants), strict=True))
    middle, spread = _median_over(values, 1 / np.maximum(sds, SYSTEMATIC_MS) ** 2)
    return OffsetFit(middle, float(np.sqrt(max(spread, fit_sd) ** 2 + SYSTEMATIC_MS**2)), "", instants, votes)


def _most_agreed(found: Crossings, period_ms: float) -> tuple[float, float, float]:
    """The offset with the most votes, ms, how many they are, and the most that is a frame or more away."""
    reach = float(np.abs(found.offset_ms).max()) + 1
    grid = np.arange(-reach, reach, BIN_MS)
    widths = np.clip(MATCH_PX / np.abs(found.across_px_per_ms), 2 * BIN_MS, None)
    votes = np.zeros(len(grid))
    for offset, width in zip(found.offset_ms, widths, strict=True):
        votes += np.exp(-0.5 * ((grid - offset) / width) ** 2)
    best = int(votes.argmax())
    elsewhere = votes[np.abs(grid - grid[best]) >= period_ms]
    return float(grid[best]), float(votes[best]), float(elsewhere.max(initial=0.0))


def _fit_line(near: Crossings, still: StillErrors, start_ms: float) -> tuple[float, float, float]:
    """The constant distance (px), error of a match (px) and sd of the offset (ms).

    Iteratively reweighted least squares (Cauchy weights) of distance = speed * offset + constant.
    """
    speed = near.across_px_per_ms
    distance = speed * near.offset_ms
    offset, shift, match_px = start_ms, still.median_px, 2.0
    rows = np.column_stack([speed, np.ones(len(speed))])
    for step in range(30):
        miss = distance - speed * offset - shift
        if step:
            match_px = max(0.1, 1.4826 * float(np.median(np.abs(miss))))
        weights = 1 / (1 + (miss / (1.5 * match_px)) ** 2)
        prior = (match_px / still.spread_px) ** 2
        normal = rows.T @ (weights[:, None] * rows) + np.diag([0.0, prior])
        offset, shift = np.linalg.solve(
            normal, rows.T @ (weights * distance) + np.array([0.0, prior * still.median_px])
        )
    return float(shift), match_px, match_px * float(np.sqrt(np.linalg.inv(normal)[0, 0]))


def _by_instant(
    near: Crossings, offsets_ms: Array, match_px: float, period_ms: float
) -> tuple[InstantOffset, ...]:
    """Every instant's own offset, where its points give it to half a frame."""
    instants = []
    for instant in np.unique(near.instant):
        its = near.instant == instant
        if its.sum() < MIN_POINTS:
            continue
        weights = (near.across_px_per_ms[its] / match_px) ** 2
        middle = _weighted_median(offsets_ms[its], weights)
        scatter = 1.4826 * _weighted_median(np.abs(offsets_ms[its] - middle), weights)
        sd = max(float(1.25 / np.sqrt(weights.sum())), 1.25 * scatter / float(np.sqrt(its.sum())))
        if sd < period_ms / 2:
            instants.append(InstantOffset(int(instant), middle, sd, int(its.sum())))
    return tuple(instants)


def _median_over(values: Array, weights: Array) -> tuple[float, float]:
    """Weighted median of instants, and its sd by bootstrap over them."""
    drawn = np.random.default_rng(0).integers(0, len(values), (RESAMPLES, len(values)))
    medians = [_weighted_median(values[of], weights[of]) for of in drawn]
    return _weighted_median(values, weights), float(np.std(medians))


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    # Half of each weight lies on either side of its value, so that equal weights give the plain median.
    middles = np.cumsum(weights[order]) - 0.5 * weights[order]
    return float(np.interp(0.5 * weights.sum(), middles, values[order]))
