"""Time offset of two cameras from moving points: crossings of epipolar lines, and the offset they agree on.

A point in an image of camera A is on its epipolar line in camera B only at the time of that image.
B's images show the point before and after. Its path in B crosses the line at the time, on B's clock, at
which A's image was taken. Motion along the line carries no information.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Self

import numpy as np
from msgspec import Struct, structs

from reconstruction.common.geometry import Array, View, epipolar_errors_px
from reconstruction.scene.calibration.consistency import consistent_matches
from reconstruction.scene.instant_choice import MIN_INSTANTS
from reconstruction.time_offsets.instant_votes import (
    DISTINCT,
    GLITCH_FRAMES,
    GLITCH_VOTES,
    MATCH_PX,
    MAX_GLITCH_FRAMES,
    MIN_VOTES,
    UNCHANGED,
    Change,
    Votes,
    count_votes,
    find_change,
)
from reconstruction.time_offsets.pair_geometry import (
    TERMS,
    geometry_terms,
    places,
)

MIN_ACROSS_PX = 1.0
"""Points that move across their line by less than this in a frame period are ignored."""
MIN_ACROSS, MIN_AGREEING = 0.15, 0.25
"""Minimum fraction of crossings of at least that speed, or of these that agree: where nearly all points move
along their lines, the others are wrong matches, of which some agree by chance (measured: 0.06 and 0.09, with
motion across the lines at least 0.48 and 0.33)."""
NEAR_PX = 4.0
"""Matches farther than this from the offset with the most votes are outliers."""
MAX_STILL_RESIDUAL_PX = 6.0
"""Matches of static points farther than this from their epipolar lines are outliers, if they are too few to
fit an epipolar geometry of their own."""
MAX_AT_REST_PX = 2.0
"""Median epipolar error of static points above which a calibration does not fit the images."""
MAX_IN_MOTION_PX = 1.0
"""The same for all matches of moving cameras at the offset found; a wrong calibration fits only some."""
TYPICAL_AT_REST_PX = 0.6
"""Median epipolar error of static points with a calibration as good as the terms of its errors assume."""
MIN_POINTS = 3
"""Minimum points of an instant; fewer may all be wrong matches."""
SHARP_FRAMES = 1 / 6
"""Maximum standard deviation of an instant's offset, in periods: a turning wheel looks alike at several."""
SYSTEMATIC_MS = 0.25
"""Systematic error left by rows, exposures and the paths between images; one standard deviation."""
SHARED_PX = 0.1
"""Error that all points in one part of the image share, independent of their number."""
INSTANT_PX = 0.12
"""Additional error that the points of one instant share."""
ALIKE_INSTANTS = 3.0
"""Number of successive instants at which an object's outline has the same error."""
CERTAIN_SIGMAS = 4.0
"""Standard deviations from which one of some twenty differs: an instant, an image's part, or its last row."""
MIN_JITTER = 3.0
"""Minimum ratio of the instants' scatter to their errors from which single images are called offset."""
MIN_JITTER_INSTANTS = 5
"""Minimum number of instants that show jitter."""
MIN_GLITCHES = 0.2
"""Minimum fraction of instants with clear offsets of their own from which images jitter."""
MIN_JITTER_FRAMES = 0.05
"""Minimum jitter, in frames."""
PARTS = 2
"""Number of parts from the middle of the image to its edge, across and down, whose bodies must agree."""
FINE_PARTS, PART_INSTANTS, PART_MS = 4, 8, 0.3
"""Number of finer parts, the fewest instants that show a part's own offset, and its systematic error. The
chi-squared of bodies of one time is at most 1.1 times the one expected, of people 6 ms late before a
television 4 and 8 times (simulated)."""
CLEARER_ROWS, MIN_ROWS = 1.25, 0.1
"""Minimum ratio of crossings that agree if rows have own offsets, and scatter of an instant's rows, in halves
of the image. With one offset the ratio is 1.07 at most, with opposite rolling shutters 1.75 (simulated)."""
ROW_FRAMES = 0.1
"""Minimum change of the offset from the middle row to the last, in periods. With one offset it is 0.05 at
most, with rolling shutters of 25 and 8 ms 0.22 to 0.26 (simulated)."""
INDEPENDENT = 1.2
"""Minimum von Neumann ratio of jitter; with less the offsets drift, as with a wrong calibration."""


@dataclass(frozen=True)
class Crossings:
    """Crossings (n,) of epipolar lines, one for each pair of matched points.

    `instant` is the instant of A's image. `offset_ms` is the delay of B's images beyond their recorded times,
    relative to A's. `across_px_per_ms` is the point's speed across the line. `counts` is the
    number of points that it counts for. `shared_px` is an error that it shares with the crossings of
    neighbouring instants. `geometry` (n, TERMS) is from `geometry_terms`. `in_second` is the instant of B's
    image whose point's line A's path crosses, or -1 if B's path crosses the line of A's point.
    """

    instant: Array
    offset_ms: Array
    across_px_per_ms: Array
    counts: Array
    shared_px: Array
    geometry: Array
    in_second: Array

    @classmethod
    def join(cls, parts: Iterable[Self]) -> Self:
        """Concatenate sets of crossings."""
        none = np.zeros(0)
        every = [cls(none, none, none, none, none, np.zeros((0, TERMS)), none), *parts]
        return cls(*(np.concatenate([getattr(part, field.name) for part in every]) for field in fields(cls)))

    def later(self, by_ms: float | Array) -> Self:
        """Return the crossings with the second camera's offset increased by `by_ms`."""
        return replace(self, offset_ms=self.offset_ms + by_ms)

    def by(self, geometry: Array) -> Self:
        """Return the crossings corrected for a geometry error (TERMS,), in units of `geometry_terms`."""
        return self.later(-(self.geometry @ geometry) / self.across_px_per_ms)

    def only(self, chosen: Array) -> Self:
        """Return the crossings selected by a mask (bool)."""
        return replace(self, **{field.name: getattr(self, field.name)[chosen] for field in fields(self)})


Path = tuple[Array, Array]
"""Points in the previous image, an image and the next one.

Positions (3, n, 2) px, NaN where a point could not be tracked; times (3, n) ms."""


def find_crossings(
    views: tuple[View, View],
    instants: tuple[int, int],
    paths: tuple[Path, Path],
    counts: Array,
    shared_px: Array,
) -> Crossings:
    """Find where B's paths cross the epipolar lines of A's points, and A's paths the lines of B's points.

    `instants` are the instants of A's image and of B's. `counts` and `shared_px` (n,) are as in `Crossings`.
    """
    a, b = paths
    later, earlier = _crossed(views, a, b), _crossed(views[::-1], b, a)
    offset_ms, across = (np.concatenate([late, -other]) for late, other in zip(later, earlier, strict=True))
    good = np.isfinite(offset_ms)
    at_a, at_b, counts, shared_px = (
        np.concatenate([part, part])[good] for part in (a[0][1], b[0][1], counts, shared_px)
    )
    of_a, geometry = np.full(len(counts), instants[0]), geometry_terms(*views, at_a, at_b)
    in_second = np.repeat([-1, instants[1]], len(good) // 2)[good]
    return Crossings(of_a, offset_ms[good], across[good], counts, shared_px, geometry, in_second)


def _crossed(views: tuple[View, View], seen: Path, path: Path) -> tuple[Array, Array]:
    """Return the offsets (n,) ms at which paths cross the lines of the points seen, and the crossing speeds.

    The distance from the line is a parabola through the three images, or a line through two. Crossings
    outside these images are NaN.
    """
    (places, seen_ms), (others, times_ms) = seen, path
    before, now, after = (_errors(views, places[1], at) for at in others)
    early, late = (times_ms[i] - times_ms[1] for i in (0, 2))
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        slope_before, slope_after = (before - now) / early, (after - now) / late
        both = np.isfinite(slope_before) & np.isfinite(slope_after)
        bend = np.where(both, (slope_after - slope_before) / (late - early), 0.0)
        straight = np.where(np.isfinite(slope_before), slope_before, slope_after)
        slope = np.where(both, slope_before - bend * early, straight)
        when = -2 * now / (slope + np.copysign(np.sqrt(slope**2 - 4 * bend * now), slope))
        first = np.where(np.isfinite(slope_before), early, -0.2 * late)
        last = np.where(np.isfinite(slope_after), late, -0.2 * early)
        inside = (when >= first) & (when <= last)
        offset_ms, across = seen_ms[1] - (times_ms[1] + when), slope + 2 * bend * when
    return np.where(inside & np.isfinite(across), offset_ms, np.nan), across


def _errors(views: tuple[View, View], at_a: Array, at_b: Array) -> Array:
    known = np.isfinite(at_b).all(1)
    errors = np.full(len(at_b), np.nan)
    if known.any():
        errors[known] = epipolar_errors_px(*views, at_a[known], at_b[known])
    return errors


def points_at_offset(a: Path, b: Path, offset_ms: float) -> tuple[Array, Array, Array]:
    """Return matches (n, 2) px in A and B at the same time, if B's images are later by an offset.

    B's points are moved along their paths by less than the time to the previous or next image. Their speeds
    (n, 2) px/ms are the third array.
    """
    (at_a, a_ms), (at_b, b_ms) = a, b
    early_ms = a_ms[1] - b_ms[1] - offset_ms
    beside = np.where((early_ms > 0)[:, None], at_b[2], at_b[0])
    steps = np.where(early_ms > 0, b_ms[2], b_ms[0]) - b_ms[1]
    speeds = (beside - at_b[1]) / steps[:, None]
    good = np.isfinite(speeds).all(1) & (np.abs(early_ms) < np.abs(steps))
    return at_a[1][good], (at_b[1] + speeds * early_ms[:, None])[good], speeds[good]


StillErrors = tuple[Array, Array]
"""Epipolar errors (n,) px of static points, and their geometry as in `Crossings`."""


def still_errors(views: tuple[View, View], at_a: Array, at_b: Array) -> StillErrors:
    """Return the epipolar errors of static matches (n, 2) px that fit one geometry, not only the views'."""
    errors = epipolar_errors_px(*views, at_a, at_b) if len(at_a) else np.zeros(0)
    consistent = consistent_matches(views, at_a, at_b)
    good = np.abs(errors) < MAX_STILL_RESIDUAL_PX if consistent is None else consistent
    terms = geometry_terms(*views, at_a[good], at_b[good]) if good.any() else np.zeros((0, TERMS))
    return errors[good], terms


def median_px(errors_px: Array) -> float:
    """Return the median size of signed errors (n,), px; 0 if there are none."""
    return float(np.median(np.abs(errors_px))) if len(errors_px) else 0.0


class InstantOffset(Struct, frozen=True):
    """Delay of the second camera measured from one instant alone; `points` is the number that agree."""

    instant: int
    late_ms: float
    sd_ms: float
    points: int


@dataclass(frozen=True)
class OffsetFit:
    """Delay of the second camera relative to the first, in total and for each instant alone.

    If it is unknown, `reason` says why, and `offset_ms` and `sd_ms` are None.
    """

    offset_ms: float | None = None
    sd_ms: float | None = None
    reason: str = ""
    instants: tuple[InstantOffset, ...] = ()
    votes: float = 0.0
    """Approximate number of crossings that agree."""
    misfit_px: float | None = None
    """Median epipolar error of static points (of all if cameras move), if the calibration does not fit them.

    0 if it is a guess from points that fit other calibrations as well. If the offset is known, it was
    measured with a geometry corrected by these points.
    """
    change: Change = UNCHANGED
    """How the offset changes over the take; `offset_ms` is then that of the first instant."""
    disagreeing: tuple[int, ...] = ()
    """Instants that have clear offsets of their own, which `change` does not explain."""
    glitches_ms: tuple[Mapping[int, float], Mapping[int, float]] = ({}, {})
    """Single images of the first and of the second camera that are at another time, each with its delay."""
    unvoted: tuple[int, ...] = ()
    """Instants that were examined and show no offset of their own."""
    repeats_ms: float = 0.0
    """Period of all that moves in front of one of the cameras; 0 if it does not repeat."""
    rows_ms: float = 0.0
    """Delay of the second camera at the last row, beyond its delay at the middle row, `offset_ms`."""
    moved: Mapping[str, str] = field(default_factory=dict)
    """Cameras that were moved during the take, and how, in words; only a part of it is measured."""
    screens: tuple[str, ...] = ()
    """Cameras that show a screen, which is left out."""

    @property
    def examined(self) -> int:
        """Number of instants that were examined."""
        return len(self._voted | {*self.unvoted})

    @property
    def _voted(self) -> set[int]:
        return (
            {instant.instant for instant in self.instants}
            | self.glitches_ms[0].keys()
            | self.glitches_ms[1].keys()
            | {*self.disagreeing}
        )

    def examined_at(self, instants: Iterable[int]) -> "OffsetFit":
        """Return the fit with the instants that show no offset as `unvoted`."""
        return replace(self, unvoted=tuple(sorted({*instants} - self._voted)))

    def later(self, by_ms: float) -> "OffsetFit":
        """Return the fit with the second camera's offset increased by `by_ms`."""
        moved = tuple(structs.replace(instant, late_ms=instant.late_ms + by_ms) for instant in self.instants)
        shifted = replace(self, instants=moved)
        return shifted if self.offset_ms is None else replace(shifted, offset_ms=self.offset_ms + by_ms)

    def under(self, others: Sequence["OffsetFit"]) -> "OffsetFit":
        """Return the fit with error bars that include these fits, of other calibrations that may be right.

        Unknown if one of them is, or if the offset changes otherwise: then it depends on the calibration.
        """
        if self.offset_ms is None or self.sd_ms is None:
            return self
        if any(other.offset_ms is None or not other.change.resembles(self.change) for other in others):
            return OffsetFit(
                reason="the calibration is a guess, and other focal lengths fit the points at rest as well "
                "but show another offset, or none: calibrate with a board"
            )

        def wider(sd_ms: float, late_ms: float, theirs_ms: Iterable[float]) -> float:
            return float(np.hypot(sd_ms, max((abs(ms - late_ms) for ms in theirs_ms), default=0.0)))

        theirs = [{instant.instant: instant.late_ms for instant in other.instants} for other in others]
        instants = tuple(
            structs.replace(
                instant,
                sd_ms=wider(
                    instant.sd_ms,
                    instant.late_ms,
                    (track[instant.instant] for track in theirs if instant.instant in track),
                ),
            )
            for instant in self.instants
        )
        offsets_ms = [other.offset_ms for other in others if other.offset_ms is not None]
        return replace(self, sd_ms=wider(self.sd_ms, self.offset_ms, offsets_ms), instants=instants)

    def odd_ms(self, min_ms: float) -> dict[int, float]:
        """Return the instants whose own offset certainly differs by `min_ms`, each with the difference."""
        common_ms = self.offset_ms or 0.0
        return {
            instant.instant: instant.late_ms - common_ms
            for instant in self.instants
            if abs(instant.late_ms - common_ms) > max(CERTAIN_SIGMAS * instant.sd_ms, min_ms)
        }

    def jitter_ms(self, period_ms: float) -> float | None:
        """Return the standard deviation of single images' own offsets, if it is certainly not zero."""
        if self.change:
            return None
        own_ms = {instant.instant: instant.late_ms - (self.offset_ms or 0.0) for instant in self.instants}
        glitches_ms = max(self.glitches_ms, key=len)
        own_ms |= glitches_ms
        if len(glitches_ms) < max(MIN_JITTER_INSTANTS, MIN_GLITCHES * len(own_ms)):
            return scatter_ms(self.instants, period_ms)[0]
        return float(np.std([*own_ms.values()]))


def misfit(count: int, points: str, off_px: float) -> OffsetFit:
    """Return the unknown offset of a calibration that points contradict by a median epipolar error."""
    return OffsetFit(
        reason=f"the calibration does not fit the pictures: {count} {points} are {off_px:.1f} pixels off"
        " their epipolar lines",
        misfit_px=off_px,
    )


def fit_offset(
    crossings: Crossings, still: StillErrors, period_ms: float, recorded_px: float = 0.0
) -> OffsetFit:
    """Fit the offset that most crossings agree on, together with the errors of the geometry.

    `recorded_px` is the median epipolar error of static points before the geometry was corrected by them.
    If rows have own offsets, it is that of the middle row.

    A calibration error moves crossings by a distance, and so by a time that depends on how fast a point
    crosses its line. The error bar includes any part of the offset that such an error could explain.
    """
    rows_ms, fit = _voted_rows_ms(crossings, period_ms), OffsetFit()
    # Each of these fits looks at the crossings near the one before: they approach the offsets of rows.
    for _ in range(4):
        middle = crossings.later(-rows_ms * places(crossings.geometry)[:, 1])
        fit = _fit_offset(middle, still, period_ms, recorded_px)
        rows_ms += fit.rows_ms
        if not fit.rows_ms:
            break
    return fit if fit.offset_ms is None else replace(fit, rows_ms=rows_ms)


def _fit_offset(
    crossings: Crossings, still: StillErrors, period_ms: float, recorded_px: float, *, steady: bool = False
) -> OffsetFit:
    """Fit as `fit_offset` does, as if all rows had one offset; `rows_ms` is the difference that this leaves.

    `steady`: the offset does not change.
    """
    if (at_rest_px := median_px(still[0])) > MAX_AT_REST_PX:
        return misfit(len(still[0]), "points at rest", at_rest_px)
    moving = crossings.only(np.abs(crossings.across_px_per_ms) * period_ms > MIN_ACROSS_PX)
    if moving.counts.sum() < MIN_VOTES:
        return OffsetFit(
            reason="too few moving points are found in both cameras, or they move along their epipolar lines"
        )
    # A calibration that is worse at rest has larger errors elsewhere too.
    prior_sd = max(1.0, max(at_rest_px, recorded_px) / TYPICAL_AT_REST_PX)
    at_rest = _fit(moving.only(np.zeros(len(moving.counts), bool)), still, prior_sd)
    votes = _votes(moving.by(at_rest.geometry))
    if change := UNCHANGED if steady else find_change(votes, period_ms):
        moving = moving.later(-change.at_ms(moving.instant, period_ms))
        votes = _votes(moving.by(at_rest.geometry))
    peak, best, rival = _best_offset(votes, period_ms)
    if best < MIN_VOTES or best < DISTINCT * rival:
        return OffsetFit(reason="the moving points do not agree on one offset")
    all_points, across = (float(points.counts.sum()) for points in (crossings, moving))
    if across < MIN_ACROSS * all_points and best < MIN_AGREEING * across:
        return OffsetFit(reason="nearly all moving points move along their epipolar lines")
    late_ms = moving.by(at_rest.geometry).offset_ms - peak
    near = (np.abs(late_ms * moving.across_px_per_ms) < NEAR_PX) & (np.abs(late_ms) < period_ms)
    first = np.append(peak, at_rest.geometry)
    fit = _fit(moving.only(near), still, prior_sd, first, at_rest.rest_px)
    if len(instants := _by_instant(fit, period_ms)) < MIN_INSTANTS:
        return OffsetFit(
            reason=f"only {len(instants)} instants have enough motion; {MIN_INSTANTS} are needed",
            instants=instants,
        )
    is_wrong = not change.witnessed([instant.instant for instant in instants])
    if change.drift:
        slope_ms, slope_sd_ms, _ = fit_slope(instants)
        more, drift_sd = slope_ms / period_ms, slope_sd_ms / period_ms
        left = _changing(instants, structs.replace(change, drift=-more), period_ms)
        # A rate leaves no drift; a wrong calibration leaves one where the motion changes its direction.
        change = structs.replace(change, drift=change.drift + more, drift_sd=drift_sd)
        is_wrong = recorded_px > 2 * TYPICAL_AT_REST_PX or scatter_ms(left, period_ms)[1]
        is_wrong |= abs(change.drift) < CERTAIN_SIGMAS * drift_sd
    if is_wrong:
        return _fit_offset(crossings, still, period_ms, recorded_px, steady=True)
    offset_ms = float(fit.values[0])
    rows_ms = fit.rows_ms(period_ms)
    bodies = _other_bodies_ms(moving.by(fit.geometry), offset_ms, period_ms)
    # Parts of other rows have other times where the rows have.
    if bodies := bodies or ([] if rows_ms else fit.part_off_ms()):
        return OffsetFit(
            reason="the moving points do not agree on one offset: in a part of the picture they are "
            f"{bodies[0]:+.0f} ms off the others (is there a screen, or another calibration?)"
        )
    # Where motion turns, a point crosses its line twice, and only at the wrong time fast.
    slower = crossings.only(np.abs(crossings.across_px_per_ms) * period_ms > MIN_ACROSS_PX / 2)
    own = _votes(slower.later(-change.at_ms(slower.instant, period_ms)).by(fit.geometry))
    return OffsetFit(
        offset_ms=offset_ms,
        sd_ms=float(np.hypot(max(fit.sd_ms, _drift_sd_ms(instants)), SYSTEMATIC_MS)),
        instants=_changing(instants, change, period_ms),
        votes=best,
        misfit_px=recorded_px if recorded_px > MAX_AT_REST_PX else None,
        change=change,
        disagreeing=own.disagreeing(offset_ms, period_ms),
        glitches_ms=_glitches_ms(moving.by(fit.geometry), offset_ms, period_ms, change),
        rows_ms=rows_ms,
    )


def _votes(seen: Crossings) -> Votes:
    return count_votes(seen.instant, seen.offset_ms, seen.across_px_per_ms, seen.counts)


def _voted_rows_ms(seen: Crossings, period_ms: float) -> float:
    """Return the offset's growth from the middle row to the last, ms; 0 unless far more crossings agree."""
    seen = seen.only(np.abs(seen.across_px_per_ms) * period_ms > MIN_ACROSS_PX)
    down = places(seen.geometry)[:, 1]
    # Growths in steps of a twentieth of a period; crossings agree within some sixteenths of one.
    slopes = np.linspace(-period_ms, period_ms, 41)
    late_ms, reach_ms = (seen.offset_ms - ms * down for ms in slopes), (-10 * period_ms, 10 * period_ms)
    counts = (np.histogram(ms, 20 * 16, reach_ms, weights=seen.counts)[0] for ms in late_ms)
    agreeing = np.array([np.convolve(count, np.ones(3)).max() for count in counts])
    if (
        agreeing.max() < max(MIN_VOTES, CLEARER_ROWS * agreeing[len(slopes) // 2])
        or _rows_apart(seen).std() < MIN_ROWS
    ):
        return 0.0
    return float(np.average(slopes, weights=np.clip(agreeing - 0.9 * agreeing.max(), 0, None)))


def _rows_apart(seen: Crossings) -> Array:
    """Return the distance of each crossing below the mean of its instant, in halves of the image.

    Rows are compared at one instant: what is small shows each row at another time.
    """
    down, (_, of_instant) = places(seen.geometry)[:, 1], np.unique(seen.instant, return_inverse=True)
    return np.asarray(down - (np.bincount(of_instant, down) / np.bincount(of_instant))[of_instant])


def _other_bodies_ms(seen: Crossings, offset_ms: float, period_ms: float) -> list[float]:
    """Return the delays beyond an offset of the clear peaks of parts of the image that contradict it."""
    parts = _votes(replace(seen, instant=np.floor(PARTS * places(seen.geometry)) @ (1, 4 * PARTS)))
    apart_ms = parts.apart_ms(offset_ms, period_ms, GLITCH_FRAMES, GLITCH_VOTES)
    return [ms for ms in apart_ms.values() if abs(ms) < MAX_GLITCH_FRAMES * period_ms]


def _glitches_ms(
    seen: Crossings, offset_ms: float, period_ms: float, change: Change
) -> tuple[dict[int, float], dict[int, float]]:
    """Return the delays of single images of A and of B beyond the offset, except beside its steps.

    An image's own points vote for its time, on the other camera's paths.
    """
    of_b = seen.in_second >= 0
    in_b = seen.only(of_b)
    votes = [_votes(seen.only(~of_b)), _votes(replace(in_b, instant=in_b.in_second))]
    first, second = (vote.apart_ms(offset_ms, period_ms, GLITCH_FRAMES, GLITCH_VOTES) for vote in votes)
    limit_ms = MAX_GLITCH_FRAMES * period_ms
    # A path over a gap shows no time there.
    beside = {k for step in change.steps for k in range(step.earliest - 1, step.latest + 1)}
    near, late = (
        {k: ms for k, ms in its.items() if abs(ms) < limit_ms and k not in beside} for its in (first, second)
    )
    return {k: -ms for k, ms in near.items()}, late


def fit_slope(instants: Sequence[InstantOffset]) -> tuple[float, float, float]:
    """Return the growth of the offsets from instant to instant, its standard deviation (ms), and the middle.

    Weighted least squares; the offsets' scatter widens their errors.
    """
    weights = np.array([instant.sd_ms for instant in instants]) ** -2.0
    at, late_ms = (
        np.array([getattr(instant, field) for instant in instants], float) for field in ("instant", "late_ms")
    )
    middle = float(np.average(at, weights=weights))
    at, late_ms = at - middle, late_ms - np.average(late_ms, weights=weights)
    normal = float(weights @ at**2)
    slope_ms = float(weights @ (at * late_ms)) / normal
    factor = max(1.0, float(weights @ (late_ms - slope_ms * at) ** 2) / max(1, len(at) - 2))
    return slope_ms, float(np.sqrt(factor / normal)), middle


def _changing(
    instants: tuple[InstantOffset, ...], change: Change, period_ms: float
) -> tuple[InstantOffset, ...]:
    """Return the instants' offsets, measured without the change, with it."""
    by_ms = change.at_ms(np.array([instant.instant for instant in instants]), period_ms)
    return tuple(
        structs.replace(instant, late_ms=instant.late_ms + float(ms))
        for instant, ms in zip(instants, by_ms, strict=True)
    )


def _drift_sd_ms(instants: tuple[InstantOffset, ...]) -> float:
    """Return the standard deviation of the mean of instants whose offsets change smoothly over the take.

    A time offset is one number, so such a drift is an error of the geometry. Neighbouring instants share it:
    the effective number of instants is that of an autoregressive process (Wilks 2011, section 5.2.4).
    """
    late_ms, sds_ms = (
        np.array([getattr(instant, name) for instant in instants]) for name in ("late_ms", "sd_ms")
    )
    off = (late_ms - np.median(late_ms)) / sds_ms
    limit = 4 * _robust_sd(off, 1.0)
    off = np.clip(off, -limit, limit)
    ratio = steps_ratio(off)
    effective = max(1.0, len(off) * ratio / (4 - ratio)) if ratio < 2 else len(off)
    return float(off.std(ddof=1) * np.sqrt(len(off) / effective / (sds_ms**-2).sum()))


def steps_ratio(values: Array) -> float:
    """Return von Neumann's ratio of the mean squared step to the variance: 2 if independent, 0 in a drift."""
    variance = float(values.var(ddof=1))
    return float(np.mean(np.diff(values) ** 2)) / variance if variance > 0 else 2.0


def scatter_ms(instants: Sequence[InstantOffset], period_ms: float) -> tuple[float | None, bool]:
    """Return the jitter (standard deviation, ms) or None, and whether the offsets drift over the take."""
    late_ms = np.array([instant.late_ms for instant in instants])
    if len(late_ms) < MIN_JITTER_INSTANTS:
        return None, False
    error_ms = float(np.median([instant.sd_ms for instant in instants]))
    found_ms = 1.4826 * float(np.median(np.abs(late_ms - np.median(late_ms))))
    if found_ms < max(MIN_JITTER * error_ms, MIN_JITTER_FRAMES * period_ms):
        return None, False
    drifts = steps_ratio(late_ms) < INDEPENDENT
    return None if drifts else float(np.sqrt(found_ms**2 - error_ms**2)), drifts


def _best_offset(votes: Votes, period_ms: float) -> tuple[float, float, float]:
    """Return the offset with the most votes (ms), its votes, and the most votes a period or more from it."""
    grid, total = votes.offsets_ms, votes.votes.sum(0)
    best = int(total.argmax())
    elsewhere = np.abs(grid - grid[best]) >= period_ms
    return float(grid[best]), float(total[best]), float(total[elsewhere].max(initial=0.0))


@dataclass(frozen=True, eq=False)
class _Fit:
    """Offset and geometry errors of a pair, as `_fit` finds them."""

    moving: Crossings
    values: Array
    """Offset, ms, and the errors of the geometry (1 + TERMS,)."""
    match_px: float
    rest_px: float
    rows: Array
    weights: Array
    miss: Array
    normal: Array

    @property
    def geometry(self) -> Array:
        """Errors of the geometry (TERMS,), each in standard deviations of its term in `geometry_terms`."""
        return self.values[1:]

    def geometry_sd_ms(self, moving: Crossings, weights: Array) -> float:
        """Return the standard deviation of crossings' weighted mean that the geometry's error leaves."""
        mean = weights @ (moving.geometry / moving.across_px_per_ms[:, None]) / weights.sum()
        return float(np.sqrt(mean @ np.linalg.inv(self.normal)[1:, 1:] @ mean))

    def rows_ms(self, period_ms: float) -> float:
        """Return the delay of the last row beyond the middle one that the fit leaves; 0 without a clear one.

        Linear regression on the place that the rest of the model does not explain (Frisch and Waugh 1933).
        """
        down, column = _rows_apart(self.moving), np.zeros(len(self.weights))
        column[: len(down)] = self.moving.across_px_per_ms * down
        own = column - self.rows @ np.linalg.solve(self.normal, self.rows.T @ (self.weights * column))
        pull = self.weights * own / (self.weights @ (own * column) + period_ms**-2)
        rows_ms = float(pull @ self.miss)
        sd_ms = self._scatter(pull * (self.miss - rows_ms * own))
        is_clear = abs(rows_ms) > max(ROW_FRAMES * period_ms, CERTAIN_SIGMAS * sd_ms)
        return rows_ms if is_clear and down.std() > MIN_ROWS else 0.0

    def part_off_ms(self) -> list[float]:
        """Return the delay of the part of the image that differs most, if parts certainly differ.

        Cochran's test (1954) of the parts' own offsets, each with its scatter over the instants.
        """
        moving, count, off = self.moving, len(self.moving.counts), list[tuple[float, float]]()
        _, of_part = np.unique(np.floor(FINE_PARTS * places(moving.geometry)), axis=0, return_inverse=True)
        for part in range(of_part.max() + 1):
            its = of_part == part
            if len(np.unique(moving.instant[its])) < PART_INSTANTS:
                continue
            speed = np.where(its, moving.across_px_per_ms, 0.0)
            pull = self.weights[:count] * speed / (self.weights[:count] @ speed**2)
            late_ms = float(pull @ self.miss[:count])
            sd_ms = self._scatter(pull * (self.miss[:count] - late_ms * speed))
            off.append((late_ms, float(np.hypot(sd_ms, PART_MS))))
        late, sds = np.array(off or [(0.0, 1.0)]).T
        sigmas = (late - np.average(late, weights=sds**-2)) / sds
        farthest = int(np.argmax(np.abs(sigmas)))
        free = max(1, len(sigmas) - 1)
        clear = sigmas @ sigmas > free + CERTAIN_SIGMAS * np.sqrt(2 * free)
        return [float(sigmas[farthest] * sds[farthest])] if clear else []

    def _scatter(self, pull: Array) -> float:
        """Return the standard deviation of a sum of moving points' pulls (n,), of which instants are drawn.

        The points of a cluster share errors: use each instant's pull (Liang and Zeger 1986). The paths of an
        instant use its neighbouring images (Newey and West 1987).
        """
        instant = self.moving.instant.astype(int)
        pulls = np.bincount(instant - instant.min(), pull[: len(instant)])
        beside = sum(2 * (1 - k / 3) * float(pulls[k:] @ pulls[:-k]) for k in (1, 2))
        instants = len(np.unique(instant))
        return float(np.sqrt(max(pulls @ pulls, pulls @ pulls + beside) * instants / max(1, instants - 1)))

    @property
    def sd_ms(self) -> float:
        """Standard deviation of the offset: the larger of the instants' scatter and the geometry's part."""
        inverse = np.linalg.inv(self.normal)
        drawn = self._scatter(self.weights * self.miss * (self.rows @ inverse[0]))
        free = max(1, len(np.unique(self.moving.instant)) - 1)
        # Few instants estimate their scatter poorly: ratio of Student's t to the normal quantile, at 95 %.
        drawn *= 1 + 1.2 / free + 2.4 / free**2
        return float(np.sqrt(max(drawn**2, inverse[0, 0])))


def _fit(
    moving: Crossings,
    still: StillErrors,
    prior_sd: float,
    first: Array | None = None,
    at_rest_px: float = 0.0,
) -> _Fit:
    """Fit by iteratively reweighted least squares (Cauchy weights), from `first` values, else from zero.

    The model is distance = speed * offset + geometry; static points have no speed term. Each geometry term
    has a zero-mean prior of `prior_sd` standard deviations. `at_rest_px` is the residual of points at rest
    alone: static points match to MATCH_PX, and the geometry's terms do not explain larger residuals.
    """
    count, (still_px, still_geometry) = len(moving.counts), still
    speeds = np.append(moving.across_px_per_ms, np.zeros(len(still_px)))
    rows = np.column_stack([speeds, np.concatenate([moving.geometry, still_geometry])])
    seen = np.concatenate([moving.offset_ms * moving.across_px_per_ms, still_px])
    weigh = _weigher(moving, still, max(0.0, at_rest_px**2 - MATCH_PX**2))
    values: Array = np.zeros(1 + TERMS) if first is None else first
    match_px = 2.0
    for step in range(20):
        miss = seen - rows @ values
        # A match is off by a tenth of a pixel or more, a static point by twice as much.
        if step:
            match_px = _robust_sd(miss[:count], 0.1)
        rest_px = _robust_sd(miss[count:], 0.2)
        weights = weigh(miss, match_px, rest_px)
        prior = np.diag([0.0 if count else 1.0, *np.full(TERMS, prior_sd**-2)])
        normal = rows.T @ (weights[:, None] * rows) + prior
        values = np.linalg.solve(normal, rows.T @ (weights * seen))
        # Errors larger than the prior's contradict it (evidence approximation, MacKay 1992).
        free = TERMS - np.trace(np.linalg.inv(normal)[1:, 1:]) / prior_sd**2
        prior_sd = max(prior_sd, float(np.sqrt(values[1:] @ values[1:] / max(1.0, free))))
    return _Fit(moving, values, match_px, rest_px if len(still_px) else 0.0, rows, weights, miss, normal)


def _weigher(
    moving: Crossings, still: StillErrors, unexplained_px2: float
) -> Callable[[Array, float, float], Array]:
    """Return a function that weighs moving and static points by their residuals and the residuals' scatter.

    More points do not reduce an error that they share: it limits the total weight of each group, px^-2.
    """
    count, (still_px, still_geometry) = len(moving.counts), still
    _, of_instant = np.unique(moving.instant, return_inverse=True)
    shared_px2 = SHARED_PX**2 + INSTANT_PX**2 / (1 + of_instant.max(initial=0)) + unexplained_px2
    counts = np.append(moving.counts, np.ones(len(still_px)))
    parts = _parts(moving.geometry, moving.instant)
    max_still = _parts(still_geometry, np.zeros(len(still_px))) / SHARED_PX**2

    def weigh(miss: Array, match_px: float, rest_px: float) -> Array:
        sds = np.append(np.hypot(match_px, moving.shared_px), np.full(len(still_px), rest_px))
        weights = counts / sds**2 / (1 + (miss / (1.5 * sds)) ** 2)
        # Geman-McClure weights, not Cauchy's: wrong static matches have the same error at all instants.
        weights[count:] /= 1 + (miss[count:] / (1.5 * rest_px)) ** 2
        # Successive instants share the error of an outline.
        object_px = np.bincount(of_instant, weights[:count] * moving.shared_px)
        object_px2 = ALIKE_INSTANTS * object_px @ object_px / max(1e-9, weights[:count].sum()) ** 2
        max_moving = parts / (shared_px2 + object_px2)
        for group, max_weight in ((np.s_[:count], max_moving), (np.s_[count:], max_still)):
            weights[group] *= min(1.0, max_weight / max(1e-9, float(weights[group].sum())))
        return np.asarray(weights)

    return weigh


def _parts(geometry: Array, instant: Array) -> float:
    """Return the mean number of image parts that contain points at an instant."""
    if not len(instant):
        return 0.0
    cells = np.unique(np.column_stack([instant, np.floor(4 * places(geometry))]), axis=0)
    return len(cells) / len(np.unique(instant))


def _robust_sd(misses: Array, min_px: float) -> float:
    return max(min_px, 1.4826 * float(np.median(np.abs(misses)))) if len(misses) else 1.0


def _by_instant(fit: _Fit, period_ms: float) -> tuple[InstantOffset, ...]:
    """Return the offset of each instant whose points determine it well enough."""
    moved, instants = fit.moving.by(fit.geometry), []
    for instant in np.unique(moved.instant):
        its = moved.only(moved.instant == instant)
        weights = its.counts * its.across_px_per_ms**2 / (fit.match_px**2 + its.shared_px**2)
        # A point has a crossing in each camera and for each other image: their errors are the same.
        _, first, point = np.unique(
            its.geometry[:, 1:3].round(9), axis=0, return_index=True, return_inverse=True
        )
        of_points = np.bincount(point, weights) / np.bincount(point)
        independent = of_points.sum() ** 2 / (of_points @ of_points)
        if (count := independent * float(np.average(its.counts[first], weights=of_points))) < MIN_POINTS:
            continue
        middle = _weighted_median(its.offset_ms, weights)
        speed2 = float(np.average(its.across_px_per_ms**2, weights=weights))
        scatter_ms2 = np.average((its.offset_ms - middle) ** 2, weights=weights)
        sd_ms = 1.25 * float(np.sqrt(max(scatter_ms2, fit.match_px**2 / speed2) / independent))
        if sd_ms < SHARP_FRAMES * period_ms:
            shared_px2 = INSTANT_PX**2 + np.average(its.shared_px**2, weights=weights)
            shared_ms2 = shared_px2 / speed2 / _parts(its.geometry, its.instant)
            whole_ms = float(np.sqrt(sd_ms**2 + shared_ms2 + fit.geometry_sd_ms(its, weights) ** 2))
            instants.append(InstantOffset(int(instant), middle, whole_ms, round(count)))
    return tuple(instants)


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    # Half of each weight is on either side of its value, so that equal weights give the plain median.
    middles = np.cumsum(weights[order]) - 0.5 * weights[order]
    return float(np.interp(0.5 * weights.sum(), middles, values[order]))
