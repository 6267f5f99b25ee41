"""Offset and skew between a node's clock and the leader's, estimated from two-way time exchanges."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import chain
from math import hypot, sqrt

from capture_app.common.bounds import Real
from capture_app.sync.clock.clock_changes import ClockChanges, ClockState
from capture_app.sync.clock.gap_watch import Cause, GapWatch, LineGap, cause_of
from capture_app.sync.clock.likely_line import (
    ASYMMETRY,
    DRIFT,
    EVEN_ODDS,
    LONG_AGO_NS,
    MAX_SKEW,
    ODD_HOSTS,
    SPELL_NS,
    STAMP_NS,
    TIGHTEST,
    LikelyLine,
    Point,
    fit_line,
    gap_of,
    lower_hull,
)
from capture_app.sync.clock.time_map import ROUNDING_NS, SIGMAS_95, TimeMap

BLOCKS = 10
"""Blocks of the usual window, outside of which old bounds are removed by the block.

Each keeps as many bounds. An estimate on a recorded WiFi link takes 4.9 ms of a processor, with 30 blocks
8.3, with 6 4.1.
"""
DRIFT_FRACTION = 0.2
"""The window of a slow link is so long that drift bends the line by this part of the asymmetry's error.

Its fast messages are few. Three cameras over a recorded WiFi link were all ready in 98.2 % of half an hour
with 30 s, their frames 147 us apart (the widest pair), and in 100 % with this, 85 us apart (simulated).
"""
PACES, LONGEST_NS = 1200, 90_000_000_000
"""Window length in units of the leader's request interval, which is 30 s at the default interval, and its
maximum. Over longer times a crystal's drift is not a straight line."""
STEP_SAMPLES = 3
"""Consecutive samples that must agree on a step of a clock."""
SLEW_SAMPLES, MAX_SLEW = 8, 0.1
"""Consecutive rejected samples that are taken as a clock slewed beyond MAX_SKEW, if a skew up to the second
value explains them. chrony slews by at most a twelfth."""
GAP_SIGMAS = 2.0
"""The gap has the errors of both directions, and the line's offset half of them."""
ALERT_NS = 5_000_000_000
"""Time for which a new line is doubted more readily, as samples of the slew may remain in it."""
LOOKS_BACK, LOOKS_CLOSER = (1, 2, 4), 0.5
"""Multiples of the time since the gap was large: the newest samples, more of them where messages are slow;
and fewer after a change, as a slew may have ended since the samples before it were removed."""
Bound = tuple[int, int]
"""Local time and bound, both in ns; lower bounds are stored negated."""


@dataclass(frozen=True, slots=True)
class ClockSample:
    """Time exchange: t0 client sends, t1 leader receives, t2 leader sends, t3 client receives; in ns."""

    t0_ns: int
    t1_ns: int
    t2_ns: int
    t3_ns: int

    @property
    def round_trip_ns(self) -> int:
        """Round-trip delay in ns: time in transit, both directions together."""
        return (self.t3_ns - self.t0_ns) - (self.t2_ns - self.t1_ns)

    @property
    def lower_ns(self) -> int:
        """Lower bound of leader minus local time at t3, in ns."""
        return self.t2_ns - self.t3_ns

    @property
    def upper_ns(self) -> int:
        """Upper bound of leader minus local time at t0, in ns."""
        return self.t1_ns - self.t0_ns


@dataclass(frozen=True, slots=True)
class PathAsymmetry:
    """Asymmetry of the path between a node and its leader, measured from images; in ns."""

    late_ns: Real
    """Correction to the leader's offset: half of the return path's excess delay."""
    uncertainty_ns: Real
    """95 % uncertainty of `late_ns`."""
    round_trip_ns: Real
    """Minimum round-trip delay when this was measured; any change since may be in one direction only."""

    def sigma(self, gap: float, gap_error: float = 0.0) -> float | None:
        """Return the standard deviation of `late_ns` on a path of minimum round-trip delay `gap`; all in ns.

        A change of the delay by up to `gap_error` is not one of the path.

        None if this is no better than the default asymmetry, unless `late_ns` exceeds three sigma: then the
        link is known to be more asymmetric than the default assumes.
        """
        changed = max(0.0, abs(gap - self.round_trip_ns) - gap_error)
        sigma = hypot(self.uncertainty_ns / SIGMAS_95, changed / 2.0)
        return sigma if sigma < max(ASYMMETRY * gap / 2.0, abs(self.late_ns) / 3.0) else None


class ClockFilter:
    """Estimator of leader time from local time: a line along the minimum delays of each direction.

    The hard bound holds for any delays, in any order, and for any clock rates that differ by at most
    MAX_SKEW. It comes from the sample of each direction that is tightest at present.
    """

    def __init__(self, *, window_ns: int = 30_000_000_000, longest_ns: int = LONGEST_NS) -> None:
        """Set the window to `window_ns`, or up to `longest_ns` if the leader asks for rare requests."""
        self._min_window_ns, self._longest_ns = window_ns, longest_ns
        self._block_ns = window_ns // BLOCKS
        self._window_ns = window_ns
        self.asymmetry: PathAsymmetry | None = None
        """Path asymmetry of the link, measured from images; None if unknown."""
        self.late_ns = 0.0
        """Asymmetry correction applied in the newest map, in ns."""
        self.chance_ns = 0.0
        """95 % error of the newest map without that of the asymmetry, in ns."""
        self.refused_steps = 0
        """Number of suspected steps that later samples did not confirm."""
        self.reset()

    def look_back(self, poll_interval_ns: int) -> None:
        """Set the window to fit a request interval in ns, so that it holds the typical number of samples.

        Samples with little delay are rare, so fewer samples would give a worse line.
        """
        self._window_ns = max(self._min_window_ns, min(PACES * poll_interval_ns, self._longest_ns))

    def reset(self) -> None:
        """Remove all samples, and what is known of the link: another leader's are next."""
        self._watch = GapWatch()
        self.changes = ClockChanges()
        """The changes of the two clocks since then."""
        self._clear()

    def _clear(self) -> None:
        """Remove all samples."""
        self.samples, self._newest_ns, self._anchor_ns = 0, LONG_AGO_NS, 0
        self._first_ns = LONG_AGO_NS
        """Local time from which on the samples are of one clock."""
        self._highest = self._lowest = (0, -LONG_AGO_NS)
        self._blocks: dict[int, tuple[list[Bound], list[Bound]]] = {}
        """Relevant upper and lower bounds of the blocks before the present one."""
        self._block, self._bounds = LONG_AGO_NS, (list[Bound](), list[Bound]())
        """Number of the present block, and all its upper and lower bounds."""
        self._past: list[tuple[Sequence[Point], Sequence[Point]]] = []
        """Upper and lower bounds of earlier blocks as points, and their lower hulls; empty until needed."""
        self._fitted: LikelyLine | None = None
        self._stale = True
        self._suspects: list[ClockSample] = []
        """Newest samples, if they contradict the earlier ones and are consistent with one clock."""

    def add(self, sample: ClockSample) -> bool:
        """Add a sample. Return False if the filter restarted.

        After a step it restarts with the last STEP_SAMPLES samples, which contradict all earlier ones and
        agree with each other. After a slew beyond MAX_SKEW it restarts with none. Fewer contradicting samples
        are ignored, as are samples with a negative round-trip delay, far too slow or older than the window.
        """
        window_ns = self._window_ns
        # Messages from before a change may still be in transit.
        since_ns = max(self._first_ns, self._newest_ns - window_ns)
        turnaround_ns, passed_ns = sample.t2_ns - sample.t1_ns, sample.t3_ns - sample.t0_ns
        if sample.t0_ns < since_ns or not 0 <= turnaround_ns <= passed_ns <= window_ns // 2:
            return True
        if not self.samples:
            self._anchor_ns = (sample.upper_ns + sample.lower_ns) // 2
            self._first_ns = sample.t0_ns
        upper = sample.t0_ns, sample.upper_ns - self._anchor_ns
        lower = sample.t3_ns, self._anchor_ns - sample.lower_ns
        highest, lowest = _tighter(self._highest, upper), _tighter(self._lowest, lower)
        if _bound_at(highest, lowest[0]) + lowest[1] < -ROUNDING_NS:
            return self._suspect(sample)
        if self._suspects:
            self._suspects.clear()
            self.refused_steps += 1
        if sample.t3_ns // self._block_ns > self._block:
            self._end_block(sample.t3_ns // self._block_ns)
        self._highest, self._lowest, self._stale = highest, lowest, True
        self.samples += 1
        self._newest_ns = max(self._newest_ns, sample.t3_ns)
        self._bounds[0].append(upper)
        self._bounds[1].append(lower)
        return True

    def time_map(self, now_local_ns: int) -> TimeMap | None:
        """Look for a changed clock, and return the time map with its epoch at a local time in ns.

        None before the first sample.
        """
        if not self._bounds[0]:
            return None
        line, age = self._look_for_change(), float(now_local_ns - self._block * self._block_ns)
        gap = abs(line.gap)
        skew_error = SIGMAS_95 * sqrt(line.skew_variance)
        self.changes.judge(self._newest_ns, line.skew, skew_error, is_known=self._is_known)
        is_slewed = self.changes.state is ClockState.CHANGED
        unseen = gap - self._gap(gap, line.excess).least if is_slewed else 0.0
        highest, lowest = _bound_at(self._highest, now_local_ns), -_bound_at(self._lowest, now_local_ns)
        sigma = None if self.asymmetry is None else self.asymmetry.sigma(gap, 2.0 * sqrt(line.excess))
        self.late_ns = 0.0 if self.asymmetry is None or sigma is None else self.asymmetry.late_ns
        offset_ns = round(min(max(line.offset + line.skew * age + self.late_ns, lowest), highest))
        # The best line through a parabola is below its end and less steep there.
        span = float(self._newest_ns - next(iter(self._blocks), self._block) * self._block_ns)
        bend = DRIFT * (span * span / 12.0 + (span + age) * age / 2.0)
        skew_drift = DRIFT * (span / 2.0 + abs(age))
        asymmetry_ns = ASYMMETRY * gap / 2.0 if sigma is None else sigma
        chance = hypot(sqrt(line.variance_at(age)), STAMP_NS, bend)
        # All growth of the round-trip delay may be in one direction.
        self.longer_ns = max((gap - self._watch.path_ns) / 2.0 - sqrt(line.excess), 0.0)
        bound = max(highest - offset_ns, offset_ns - lowest) + unseen + ROUNDING_NS
        self.chance_ns = SIGMAS_95 * chance + self.longer_ns + unseen
        skew_bound = MAX_SKEW + abs(line.skew)
        return TimeMap(
            epoch_local_ns=now_local_ns,
            offset_ns=self._anchor_ns + offset_ns,
            skew=line.skew,
            uncertainty_ns=min(SIGMAS_95 * hypot(chance, asymmetry_ns) + self.longer_ns + unseen, bound),
            hard_bound_ns=bound,
            skew_uncertainty=min(SIGMAS_95 * sqrt(line.skew_variance + skew_drift**2), skew_bound),
            skew_bound=skew_bound,
            drift_uncertainty=SIGMAS_95 * DRIFT,
            samples=self.samples,
            round_trip_ns=round(gap),
        )

    def _suspect(self, sample: ClockSample) -> bool:
        """Record a sample that contradicts the earlier ones. Return as `add` does."""
        self._suspects = [s for s in self._suspects if _can_both_be(s, sample, MAX_SLEW)] + [sample]
        suspects = [s for s in self._suspects if _can_both_be(s, sample, MAX_SKEW)]
        if len(suspects) < STEP_SAMPLES and len(self._suspects) < SLEW_SAMPLES:
            return True
        self.changes.note(self._newest_ns, self._line().skew, is_step=True)
        self._watch.restart(self._newest_ns)
        self._clear()
        for suspect in suspects:
            self.add(suspect)
        return False

    def _line(self) -> LikelyLine:
        """Return the line through all samples, with the beginning of the present block as its reference."""
        ref_ns = self._block * self._block_ns
        if not self._past:
            for side in (0, 1):
                points = [(t - ref_ns, v) for block in self._blocks.values() for t, v in block[side]]
                self._past.append((points, lower_hull(points)))
        if self._fitted is None or self._stale:
            new = [[(t - ref_ns, v) for t, v in bounds] for bounds in self._bounds]
            above, below = (
                ([*past, *points], lower_hull([*hull, *points]))
                for (past, hull), points in zip(self._past, new, strict=True)
            )
            odd = EVEN_ODDS if self.changes.state is ClockState.CHANGED else ODD_HOSTS
            self._fitted, self._stale = fit_line(*above, *below, odd=odd), False
        return self._fitted

    def _end_block(self, number: int) -> None:
        """Reduce the present block to its relevant bounds, remove those before the window, and begin one."""
        for bounds, slope in zip(self._bounds, (1.0, -1.0), strict=True):
            if len(bounds) > TIGHTEST:
                slope *= (self._fitted or self._line()).skew
                nearest = sorted(bounds, key=lambda bound: bound[1] - slope * (bound[0] - self._newest_ns))
                relevant = {*lower_hull(bounds), *nearest[:TIGHTEST]}
                bounds[:] = [bound for bound in bounds if bound in relevant]
        self._blocks[self._block] = self._bounds
        gap_ns = 0.0 if self._fitted is None else max(self._fitted.gap, 0.0)
        straight_ns = sqrt(12.0 * DRIFT_FRACTION * ASYMMETRY * gap_ns / 2.0 / DRIFT)
        window_ns = max(self._window_ns, min(straight_ns, self._longest_ns))
        oldest = (self._newest_ns - window_ns) // self._block_ns
        self._blocks = {i: bounds for i, bounds in self._blocks.items() if i >= oldest}
        self._block, self._bounds = number, ([], [])
        self._past.clear()

    @property
    def _is_known(self) -> bool:
        """Whether the samples of the present clock span so many spells of the link as show their scatter."""
        return self._newest_ns - self._first_ns >= TIGHTEST * SPELL_NS

    def _all_bounds(self) -> list[tuple[list[Bound], list[Bound]]]:
        return [*self._blocks.values(), self._bounds]

    def _gap(self, gap: float, excess: float) -> LineGap:
        return LineGap(self._newest_ns, gap, GAP_SIGMAS * sqrt(excess))

    def _look_for_change(self) -> LikelyLine:
        """Return the line of the present clock: a new one if the samples are those of two clocks."""
        line, is_steady = self._line(), self.changes.state is ClockState.STEADY
        is_changed, spans_ns = self.changes.state is ClockState.CHANGED, self._newest_ns - self._first_ns
        before = self._watch.before(line.gap, is_alert=is_changed and spans_ns < ALERT_NS)
        if self._is_known:
            self._watch.add(self._gap(line.gap, line.excess), is_of_path=is_steady)
        if before is None:
            return line
        for multiple in LOOKS_BACK if is_steady else (*LOOKS_BACK, LOOKS_CLOSER):
            since_ns = self._newest_ns - round(multiple * (self._newest_ns - before.local_ns))
            newest = [
                [(t - since_ns, v) for bounds in self._all_bounds() for t, v in bounds[side] if t > since_ns]
                for side in (0, 1)
            ]
            if min(map(len, newest)) < TIGHTEST:
                continue
            cause = cause_of(before, line.gap, self._gap(*gap_of(*newest)))
            if cause is Cause.CLOCK:
                self._watch.restart(self._newest_ns)
                self.changes.note(self._newest_ns, line.skew)
                return self._forget_before(since_ns)
            # No path lets messages arrive before they are sent.
            if cause is Cause.PATH and is_steady and line.gap > 0.0:
                self._watch.forget_before(before.local_ns)
                return line
        return line

    def _forget_before(self, local_ns: int) -> LikelyLine:
        """Remove the samples until a local time in ns, and return the line of the others."""
        self._first_ns = local_ns
        for side in chain(*self._all_bounds()):
            side[:] = [bound for bound in side if bound[0] > local_ns]
        self._blocks = {i: bounds for i, bounds in self._blocks.items() if any(bounds)}
        self._past.clear()
        self._stale = True
        # The premise of the hard bound may not have held either.
        self._highest, self._lowest = (
            reduce(_tighter, chain(*(bounds[side] for bounds in self._all_bounds()))) for side in (0, 1)
        )
        return self._line()


def _bound_at(bound: Bound, local_ns: int) -> float:
    return bound[1] + MAX_SKEW * abs(local_ns - bound[0])


def _can_both_be(sample: ClockSample, other: ClockSample, max_skew: float) -> bool:
    """Whether two samples are consistent with the same two clocks at rates up to `max_skew` apart."""
    slack = max_skew * (max(sample.t3_ns, other.t3_ns) - min(sample.t0_ns, other.t0_ns)) + ROUNDING_NS
    return sample.lower_ns <= other.upper_ns + slack and other.lower_ns <= sample.upper_ns + slack


def _tighter(bound: Bound, other: Bound) -> Bound:
    """Return the bound that is tighter at the later one's time and from then on."""
    return bound if bound[1] - other[1] <= MAX_SKEW * (bound[0] - other[0]) else other
