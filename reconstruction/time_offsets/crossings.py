"""Time offset of two cameras by what moves: crossings of epipolar lines, and the offset that they agree on.

A point that camera A shows at a time lies on its epipolar line in camera B at that same time only. B's
images show it before and after; where its path crosses the line, in B's own time, is when A's image was
taken. Motion along the line tells nothing.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from reconstruction.common.geometry import Array, View, other_from_reference


@dataclass(frozen=True)
class Crossings:
    """Crossings (n,) of epipolar lines, one for each pair of matched points.

    `instant` of A's image, `offset_ms`: how much later than its times say B's images were taken, against A's;
    `across_px_per_ms`: how fast the point crosses the line.
    """

    instant: Array
    offset_ms: Array
    across_px_per_ms: Array

    @classmethod
    def join(cls, parts: Iterable[Self]) -> Self:
        """All of them in one."""
        known = [(part.instant, part.offset_ms, part.across_px_per_ms) for part in parts]
        return cls(*(np.concatenate([np.zeros(0), *of]) for of in zip(*known, strict=True))) if known else (
            cls(np.zeros(0), np.zeros(0), np.zeros(0))
        )  # fmt: skip

    def later(self, by_ms: float) -> "Crossings":
        """The same, as if the second camera were later by so much."""
        return Crossings(self.instant, self.offset_ms + by_ms, self.across_px_per_ms)

    def only(self, chosen: Array) -> "Crossings":
        """Those that are chosen (bool)."""
        return Crossings(self.instant[chosen], self.offset_ms[chosen], self.across_px_per_ms[chosen])


@dataclass(frozen=True)
class Path:
    """Points in the image before, an image and the one after.

    `at` (3, n, 2) px, NaN where a point was not followed; `times_ms` (3, n).
    """

    at: Array
    times_ms: Array


def epipolar_errors_px(a: View, b: View, at_a: Array, at_b: Array) -> Array:
    """Signed distances (n,) of matched pixels (n, 2) from the epipolar geometry of two views, px.

    To first order (Sampson 1982; Hartley and Zisserman, 2nd edition, section 11.4.3). The views must not
    stand at one place.
    """
    rotation, translation = other_from_reference(a, b)
    x, y, z = translation / np.linalg.norm(translation)
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ rotation
    rays_a, rays_b = a.rays(at_a), b.rays(at_b)
    lines_b, lines_a = rays_a @ essential.T, rays_b @ essential
    steepness = np.sqrt((lines_b[:, :2] ** 2).sum(1) / b.focal**2 + (lines_a[:, :2] ** 2).sum(1) / a.focal**2)
    return np.asarray((rays_b * lines_b).sum(1) / np.maximum(steepness, 1e-12))


def find_crossings(
    views: tuple[View, View], instant: int, at_a: Array, times_a_ms: Array, path_b: Path
) -> Crossings:
    """The crossings of points (n, 2) px of A's image at `instant`, seen at `times_a_ms` (n,), by B's path.

    The distance from the line is a parabola through the three images of B, or a line through two; crossings
    outside them are left out.
    """
    before, now, after = (_errors(views, at_a, at) for at in path_b.at)
    early, late = (path_b.times_ms[i] - path_b.times_ms[1] for i in (0, 2))
    with np.errstate(invalid="ignore", divide="ignore"):
        slope_before, slope_after = (before - now) / early, (after - now) / late
        both = np.isfinite(slope_before) & np.isfinite(slope_after)
        bend = np.where(both, (slope_after - slope_before) / (late - early), 0.0)
        straight = np.where(np.isfinite(slope_before), slope_before, slope_after)
        slope = np.where(both, slope_before - bend * early, straight)
        root = np.sqrt(slope**2 - 4 * bend * now)
        when = -2 * now / (slope + np.copysign(root, slope))
        first = np.where(np.isfinite(slope_before), early, -0.2 * late)
        last = np.where(np.isfinite(slope_after), late, -0.2 * early)
        inside = (when >= first) & (when <= last)
    found = Crossings(
        np.full(len(at_a), instant),
        times_a_ms - (path_b.times_ms[1] + when),
        slope + 2 * bend * when,
    )
    return found.only(inside & np.isfinite(found.offset_ms))


def _errors(views: tuple[View, View], at_a: Array, at_b: Array) -> Array:
    known = np.isfinite(at_b).all(1)
    errors = np.full(len(at_b), np.nan)
    if known.any():
        errors[known] = epipolar_errors_px(*views, at_a[known], at_b[known])
    return errors


MATCH_PX = 0.5
"""Error of a match across its epipolar line, to begin with; then it is measured."""
LEAST_ACROSS_PX = 1.0
"""Points that cross their line by less within a frame tell nothing."""
BIN_MS = 0.25
NEAR_PX = 4.0
"""Matches that are further from what most agree on are wrong ones."""
LEAST_VOTES = 6.0
"""Fewest crossings that must agree."""
DISTINCT = 1.6
"""Ratio of the crossings that agree to those on any other offset: wrong ones agree on everything."""
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
