"""Time offset of two cameras by what moves: crossings of epipolar lines, and the offset that they agree on.

A point that camera A shows at a time lies on its epipolar line in camera B at that same time only. B's
images show it before and after; where its path crosses the line, in B's own time, is when A's image was
taken. Motion along the line tells nothing.
"""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from msgspec import Struct, structs

from reconstruction.common.geometry import Array, View
from reconstruction.time_offsets.pair_geometry import (
    TERMS,
    epipolar_errors_px,
    geometry_terms,
    places,
)

MATCH_PX = 0.5
"""Error of a match across its epipolar line, to begin with; then it is measured."""
LEAST_MATCH_PX = 0.1
LEAST_STILL_PX = 0.2
LEAST_ACROSS_PX = 1.0
"""Points that cross their line by less within a frame tell nothing."""
BIN_MS = 0.25
NEAR_PX = 4.0
"""Matches that are further from what most agree on are wrong ones."""
FARTHEST_STILL_PX = 6.0
"""Matches of what stands still that are further from their epipolar lines are wrong ones."""
LEAST_VOTES = 6.0
"""Fewest crossings that must agree."""
DISTINCT = 1.6
"""Ratio of the crossings that agree to those on any other offset: wrong ones agree on everything."""
MIN_POINTS = 3
"""Fewer points of an instant may all be wrong matches."""
MIN_INSTANTS = 3
"""With fewer instants there is no error bar that could be believed."""
SHARP_FRAMES = 1 / 6
"""What an instant tells less sharply is not told: a wheel that turns looks alike at several offsets."""
SYSTEMATIC_MS = 0.25
"""What is left of rows, exposures and the paths between images; one standard deviation."""
SHARED_PX = 0.1
"""What all points of one part of the picture err by together, however many they are."""
INSTANT_PX = 0.12
"""What those of one instant err by together besides."""
ROUNDS = 20


@dataclass(frozen=True)
class Crossings:
    """Crossings (n,) of epipolar lines, one for each pair of matched points.

    `instant` of A's image, `offset_ms`: how much later than its times say B's images were taken, against A's;
    `across_px_per_ms`: how fast the point crosses the line; `counts`: for how many points it counts;
    `geometry` (n, TERMS), of `geometry_terms`.
    """

    instant: Array
    offset_ms: Array
    across_px_per_ms: Array
    counts: Array
    geometry: Array

    @classmethod
    def join(cls, parts: Iterable[Self]) -> Self:
        """All of them in one."""
        none = np.zeros(0)
        every = [cls(none, none, none, none, np.zeros((0, TERMS))), *parts]
        return cls(*(np.concatenate([getattr(one, of.name) for one in every]) for of in fields(cls)))

    def later(self, by_ms: float | Array) -> Self:
        """The same, as if the second camera were later by so much."""
        return replace(self, offset_ms=self.offset_ms + by_ms)

    def by(self, geometry: Array) -> Self:
        """The same by another geometry, (TERMS,) of `geometry_terms`."""
        return self.later(-(self.geometry @ geometry) / self.across_px_per_ms)

    def only(self, chosen: Array) -> Self:
        """Those that are chosen (bool)."""
        return replace(self, **{of.name: getattr(self, of.name)[chosen] for of in fields(self)})


Path = tuple[Array, Array]
"""Points in the image before, an image and the one after: where, (3, n, 2) px, NaN where a point was not
followed, and when, (3, n) ms."""


def find_crossings(views: tuple[View, View], instant: int, a: Path, b: Path, counts: Array) -> Crossings:
    """Where the points of A's image at an instant cross by B's path, and those of B's image by A's.

    `counts` (n,): for how many points each counts.
    """
    later = _crossed(views, a, b)
    earlier = _crossed(views[::-1], b, a)
    parts = []
    for offset_ms, across in (later, (-earlier[0], -earlier[1])):
        good = np.isfinite(offset_ms)
        if good.any():
            geometry = geometry_terms(*views, a[0][1][good], b[0][1][good])
            instants = np.full(int(good.sum()), instant)
            parts.append(Crossings(instants, offset_ms[good], across[good], counts[good], geometry))
    return Crossings.join(parts)


def _crossed(views: tuple[View, View], seen: Path, path: Path) -> tuple[Array, Array]:
    """The offset (n,) ms at which points in the middle of their path are crossed by the other, and how fast.

    The distance from the line is a parabola through the three images, or a line through two; NaN for
    crossings outside them.
    """
    (places, seen_ms), (others, times_ms) = seen, path
    before, now, after = (_errors(views, places[1], at) for at in others)
    early, late = (times_ms[i] - times_ms[1] for i in (0, 2))
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
        offset_ms = seen_ms[1] - (times_ms[1] + when)
    return np.where(inside, offset_ms, np.nan), slope + 2 * bend * when


def _errors(views: tuple[View, View], at_a: Array, at_b: Array) -> Array:
    known = np.isfinite(at_b).all(1)
    errors = np.full(len(at_b), np.nan)
    if known.any():
        errors[known] = epipolar_errors_px(*views, at_a[known], at_b[known])
    return errors


StillErrors = tuple[Array, Array]
"""Epipolar errors (n,) px of what stands still, and their geometry as of `Crossings`."""


def still_errors(views: tuple[View, View], at_a: Array, at_b: Array) -> StillErrors:
    """Of matches (n, 2) px, without those that are wrong."""
    errors = epipolar_errors_px(*views, at_a, at_b) if len(at_a) else np.zeros(0)
    near = np.abs(errors) < FARTHEST_STILL_PX
    if not near.any():
        return np.zeros(0), np.zeros((0, TERMS))
    return errors[near], geometry_terms(*views, at_a[near], at_b[near])


class InstantOffset(Struct, frozen=True):
    """How late the second camera is by one instant's image of the first alone; `points` is how many agree."""

    instant: int
    late_ms: float
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
        moved = tuple(structs.replace(one, late_ms=one.late_ms + by_ms) for one in self.instants)
        offset_ms = None if self.offset_ms is None else self.offset_ms + by_ms
        return replace(self, offset_ms=offset_ms, instants=moved)


def fit_offset(crossings: Crossings, still: StillErrors, period_ms: float) -> OffsetFit:
    """The offset that most crossings agree on, fitted with the errors of the geometry.

    A calibration that is off moves crossings by a distance, and so by a time that depends on how fast a point
    crosses its line. What of an offset such an error could explain is in the error bar.
    """
    found = crossings.only(np.abs(crossings.across_px_per_ms) * period_ms > LEAST_ACROSS_PX)
    if found.counts.sum() < LEAST_VOTES:
        return OffsetFit(
            reason="both cameras recognize too few moving points, or these move along their epipolar lines"
        )
    at_rest = _Fit(found.only(np.zeros(len(found.counts), bool)), still)
    seen = found.by(at_rest.geometry)
    peak, votes, rival = _most_agreed(seen, period_ms)
    if votes < LEAST_VOTES or votes < DISTINCT * rival:
        return OffsetFit(reason="the points that move do not agree on one offset")
    misses = (seen.offset_ms - peak) * seen.across_px_per_ms
    near = (np.abs(misses) < NEAR_PX) & (np.abs(seen.offset_ms - peak) < period_ms)
    fit = _Fit(found.only(near), still, np.array([peak, *at_rest.geometry]))
    instants = _by_instant(fit, period_ms)
    if len(instants) < MIN_INSTANTS:
        return OffsetFit(
            reason=f"it takes {MIN_INSTANTS} instants at which it can be measured, not {len(instants)}",
            instants=instants,
        )
    return OffsetFit(float(fit.values[0]), float(np.hypot(fit.sd_ms, SYSTEMATIC_MS)), "", instants, votes)


def _most_agreed(found: Crossings, period_ms: float) -> tuple[float, float, float]:
    """The offset with the most votes, ms, how many they are, and the most that is a frame or more away."""
    reach = float(np.abs(found.offset_ms).max()) + 1
    grid = np.arange(-reach, reach, BIN_MS)
    widths = np.clip(MATCH_PX / np.abs(found.across_px_per_ms), 2 * BIN_MS, None)
    votes = np.zeros(len(grid))
    for offset, width, count in zip(found.offset_ms, widths, found.counts, strict=True):
        votes += count * np.exp(-0.5 * ((grid - offset) / width) ** 2)
    best = int(votes.argmax())
    elsewhere = votes[np.abs(grid - grid[best]) >= period_ms]
    return float(grid[best]), float(votes[best]), float(elsewhere.max(initial=0.0))


class _Fit:
    """The offset and the geometry of a pair: iteratively reweighted least squares (Cauchy weights).

    distance = speed * offset + geometry, the same without speed of what stands still; each of the geometry's
    terms is zero within a standard deviation before anything is seen.
    """

    def __init__(self, moving: Crossings, still: StillErrors, start: Array | None = None) -> None:
        self.moving = moving
        count = len(moving.counts)
        still_px, still_geometry = still
        rows = np.column_stack(
            [
                np.concatenate([moving.across_px_per_ms, np.zeros(len(still_px))]),
                np.concatenate([moving.geometry, still_geometry]),
            ]
        )
        seen = np.concatenate([moving.offset_ms * moving.across_px_per_ms, still_px])
        prior = np.diag([0.0 if count else 1.0, *np.ones(TERMS)])
        # The most that each can weigh, px^-2: what is shared does not get less by more points.
        shared_px2 = SHARED_PX**2 + INSTANT_PX**2 / max(1, len(np.unique(moving.instant)))
        most = (
            _parts(moving.geometry, moving.instant) / shared_px2,
            _parts(still_geometry, np.zeros(len(seen) - count)) / SHARED_PX**2,
        )
        self.values = np.zeros(1 + TERMS) if start is None else start
        match_px = 2.0
        for step in range(ROUNDS):
            miss = seen - rows @ self.values
            if step:
                match_px = _spread(miss[:count], LEAST_MATCH_PX)
            rest_px = _spread(miss[count:], LEAST_STILL_PX)
            sds = np.concatenate([np.full(count, match_px), np.full(len(seen) - count, rest_px)])
            weights = np.concatenate([moving.counts, np.ones(len(seen) - count)])
            weights = weights / sds**2 / (1 + (miss / (1.5 * sds)) ** 2)
            # Geman and McClure's, not Cauchy's: wrong matches of what stands still err alike at all instants.
            weights[count:] /= 1 + (miss[count:] / (1.5 * rest_px)) ** 2
            for of, its in zip((np.s_[:count], np.s_[count:]), most, strict=True):
                weights[of] *= min(1.0, its / max(1e-9, float(weights[of].sum())))
            normal = rows.T @ (weights[:, None] * rows) + prior
            self.values = np.linalg.solve(normal, rows.T @ (weights * seen))
        self.match_px = match_px
        self._rows, self._weights, self._miss, self._normal = rows, weights, miss, normal

    @property
    def geometry(self) -> Array:
        """By how many standard deviations each of `geometry_terms` is off, (TERMS,)."""
        return self.values[1:]

    @property
    def sd_ms(self) -> float:
        """Of the offset: by the scatter of the instants, or by what the geometry could explain."""
        count, instant = len(self.moving.counts), self.moving.instant.astype(int)
        inverse = np.linalg.inv(self._normal)
        pull = self._weights[:count] * self._miss[:count] * (self._rows[:count] @ inverse[0])
        # A cluster's points err together: what each instant alone pulls the offset by (Liang and Zeger 1986);
        # and paths of an instant use the pictures beside it (Newey and West 1987).
        pulls = np.bincount(instant - instant.min(), pull)
        beside = sum(2 * (1 - k / 3) * float(pulls[k:] @ pulls[:-k]) for k in (1, 2))
        instants = len(np.unique(instant))
        drawn = float(np.sqrt(max(pulls @ pulls, pulls @ pulls + beside) * instants / max(1, instants - 1)))
        free = max(1, instants - 1)
        # Few instants tell their own scatter poorly: Student's t over the normal law, at 95 %.
        drawn *= 1 + 1.2 / free + 2.4 / free**2
        return float(np.sqrt(max(drawn**2, inverse[0, 0])))


def _parts(geometry: Array, instant: Array) -> float:
    """In how many parts of the picture there are points at an instant, on the average."""
    if not len(instant):
        return 0.0
    cells = np.floor(4 * places(geometry)) @ np.array([1.0, 100.0])
    return len(np.unique(np.stack([instant, cells]), axis=1).T) / len(np.unique(instant))


def _spread(misses: Array, least: float) -> float:
    return max(least, 1.4826 * float(np.median(np.abs(misses)))) if len(misses) else 1.0


def _by_instant(fit: _Fit, period_ms: float) -> tuple[InstantOffset, ...]:
    """Every instant's own offset, where its points give it."""
    moved, instants = fit.moving.by(fit.geometry), []
    for instant in np.unique(moved.instant):
        its = moved.only(moved.instant == instant)
        if its.counts.sum() < MIN_POINTS:
            continue
        weights = its.counts * (its.across_px_per_ms / fit.match_px) ** 2
        middle = _weighted_median(its.offset_ms, weights)
        scatter = 1.4826 * _weighted_median(np.abs(its.offset_ms - middle), weights)
        left = INSTANT_PX / np.sqrt(np.mean(its.across_px_per_ms**2) * _parts(its.geometry, its.instant))
        sd = max(1.25 / np.sqrt(weights.sum()), 1.25 * scatter / np.sqrt(its.counts.sum()))
        sd = float(np.hypot(sd, left))
        if sd < SHARP_FRAMES * period_ms:
            instants.append(InstantOffset(int(instant), middle, sd, int(its.counts.sum())))
    return tuple(instants)


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    # Half of each weight lies on either side of its value, so that equal weights give the plain median.
    middles = np.cumsum(weights[order]) - 0.5 * weights[order]
    return float(np.interp(0.5 * weights.sum(), middles, values[order]))
