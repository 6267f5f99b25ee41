"""Synchronization errors between a rig's cameras, measured with a panel: the paper's tables.

Total error: from the panel. Phase error: from the session's timestamps, visible to the rig and left
uncorrected. Clock error: the remainder, invisible to the rig (paper, section 6). Each is the second camera's
time minus the first's.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import combinations, pairwise
from statistics import fmean, median, pstdev

from msgspec import Struct

from capture_app.companions.panel.pattern import nearest_ns
from capture_app.companions.panel.session_times import PictureTime, SessionTimes, pairs


class ErrorSummary(Struct, frozen=True, kw_only=True):
    """Mean absolute, standard deviation, maximum absolute and mean (bias) of one kind of error, in ns."""

    mean_abs_ns: float
    std_ns: float
    max_ns: float
    bias_ns: float


class PairError(Struct, frozen=True, kw_only=True):
    """Time errors between two images of one instant, in ns, second minus first."""

    instant: int
    first: str
    second: str
    total_ns: float
    reading_uncertainty_ns: float
    """95 % uncertainty of the total."""
    phase_ns: int
    clock_ns: float
    session_uncertainty_ns: float | None
    """95 % uncertainty of the two clocks according to the session; None if it gives none."""
    session_bound_ns: float | None
    true_total_ns: int | None
    """True total error, in a simulated session."""


class PairTable(Struct, frozen=True, kw_only=True):
    """Errors of one pair of cameras, or of all pairs together."""

    cameras: tuple[str, ...]
    count: int
    total: ErrorSummary
    phase: ErrorSummary
    clock: ErrorSummary
    reading_uncertainty_ns: float
    """Median uncertainty of the panel readings."""


class Held(Struct, frozen=True, kw_only=True):
    """Coverage of an error bar: number of cases in which it contained the true error, out of `count`."""

    held: int
    count: int


class SessionErrors(Struct, frozen=True, kw_only=True):
    """Synchronization errors of a session, as its panel shows them."""

    all: PairTable | None
    """Errors of all pairs; None if no instant has two readable images."""
    pairs: tuple[PairTable, ...]
    errors: tuple[PairError, ...]
    within_uncertainty: Held | None
    """Coverage of clock errors by the session's uncertainty combined with the panel's."""
    within_bound: Held | None
    totals_near_truth: Held | None
    """Coverage of the true totals by the panel's uncertainty."""
    largest_reading_error_ns: float | None
    """Largest difference of a total from the truth."""
    rate_error_ppm: float | None
    """Rate of the panel's clock relative to the session's; positive if the panel is faster."""
    rate_uncertainty_ppm: float | None


def rig_errors(times: SessionTimes) -> SessionErrors:
    """Return the errors that a session's panel images show, per pair and for all pairs."""
    errors = [_pair_error(first, other, times.panel.cycle_ns) for first, other in pairs(times)]
    by_pair = {
        cameras: [error for error in errors if (error.first, error.second) == cameras]
        for cameras in combinations(times.cameras, 2)
    }
    misses = [
        (abs(e.total_ns - e.true_total_ns), e.reading_uncertainty_ns)
        for e in errors
        if e.true_total_ns is not None
    ]
    rate = _rate(times)
    return SessionErrors(
        all=_table(times.cameras, errors) if errors else None,
        pairs=tuple(_table(cameras, some) for cameras, some in by_pair.items() if some),
        errors=tuple(errors),
        within_uncertainty=_held(
            abs(e.clock_ns) <= math.hypot(e.session_uncertainty_ns, e.reading_uncertainty_ns)
            for e in errors
            if e.session_uncertainty_ns is not None
        ),
        within_bound=_held(
            abs(e.clock_ns) <= e.session_bound_ns + e.reading_uncertainty_ns
            for e in errors
            if e.session_bound_ns is not None
        ),
        totals_near_truth=_held(miss <= known_to for miss, known_to in misses),
        largest_reading_error_ns=max((miss for miss, _ in misses), default=None),
        rate_error_ppm=None if rate is None else rate[0],
        rate_uncertainty_ppm=None if rate is None else rate[1],
    )


def _pair_error(one: PictureTime, other: PictureTime, cycle_ns: float) -> PairError:
    phase_ns = other.stamp_ns - one.stamp_ns
    # The panel repeats after a cycle: of all possible totals, take the one nearest to the timestamps'
    # difference.
    total_ns = phase_ns + nearest_ns(other.panel_ns - one.panel_ns - phase_ns, cycle_ns)
    stated = _both(one.image.uncertainty_ns, other.image.uncertainty_ns)
    bounds = _both(one.image.hard_bound_ns, other.image.hard_bound_ns)
    true = _both(one.true_ns, other.true_ns)
    return PairError(
        instant=one.image.instant,
        first=one.image.camera,
        second=other.image.camera,
        total_ns=total_ns,
        reading_uncertainty_ns=math.hypot(one.uncertainty_ns, other.uncertainty_ns),
        phase_ns=phase_ns,
        clock_ns=total_ns - phase_ns,
        session_uncertainty_ns=None if stated is None else math.hypot(*stated),
        session_bound_ns=None if bounds is None else float(sum(bounds)),
        true_total_ns=None if true is None else true[1] - true[0],
    )


def _both(one: int | None, other: int | None) -> tuple[int, int] | None:
    return None if one is None or other is None else (one, other)


def _table(cameras: Sequence[str], errors: Sequence[PairError]) -> PairTable:
    return PairTable(
        cameras=tuple(cameras),
        count=len(errors),
        total=_summary([error.total_ns for error in errors]),
        phase=_summary([error.phase_ns for error in errors]),
        clock=_summary([error.clock_ns for error in errors]),
        reading_uncertainty_ns=median(error.reading_uncertainty_ns for error in errors),
    )


def _summary(values: Sequence[float]) -> ErrorSummary:
    return ErrorSummary(
        mean_abs_ns=fmean(map(abs, values)),
        std_ns=pstdev(values),
        max_ns=max(map(abs, values)),
        bias_ns=fmean(values),
    )


def _held(flags: Iterable[bool]) -> Held | None:
    every = list(flags)
    return Held(held=sum(every), count=len(every)) if every else None


def _rate(times: SessionTimes) -> tuple[float, float] | None:
    """Return the panel's rate relative to the timestamps and its 95 % uncertainty, both in ppm.

    Uses each camera's consecutive images that are less than half a cycle apart.
    """
    rates, cycle_ns = [], times.panel.cycle_ns
    for name in times.cameras:
        own = (picture for picture in times.pictures if picture.image.camera == name)
        mine = sorted(own, key=lambda picture: picture.stamp_ns)
        gained_ns = passed_ns = 0.0
        for first, other in pairwise(mine):
            stamps_ns = other.stamp_ns - first.stamp_ns
            if 0 < stamps_ns < cycle_ns / 2:
                gained_ns += nearest_ns(other.panel_ns - first.panel_ns - stamps_ns, cycle_ns)
                passed_ns += stamps_ns
        if passed_ns:
            error_ns = math.hypot(mine[0].uncertainty_ns, mine[-1].uncertainty_ns)
            rates.append((1e6 * gained_ns / passed_ns, 1e6 * error_ns / passed_ns))
    return (median(rate for rate, _ in rates), median(error for _, error in rates)) if rates else None
