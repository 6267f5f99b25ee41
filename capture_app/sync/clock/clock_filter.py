"""The offset and skew between a node's clock and the leader's, from two-way time messages.

A message cannot arrive before it was sent, so each one bounds the offset from one side. The estimate takes
the tightest bounds of the two directions apart; the hard bound is all that the bounds leave possible.
"""

from dataclasses import dataclass
from math import sqrt

from capture_app.sync.clock.feasible_lines import FeasibleLines
from capture_app.sync.clock.minimum_delay import DelayExcess, estimate_excess, radius_95
from capture_app.sync.clock.skew_vote import Point, VotedLine, vote_on_skews
from capture_app.sync.clock.tight_bounds import BLOCK_NS, RUNNERS_UP, Block, Bound, OneWayBounds
from capture_app.sync.clock.time_map import TimeMap

ASYMMETRY_SHARE = 0.025
"""One sigma of half the difference between the minimum delays of the two directions, as a share of half the
least round trip: two-way messages cannot measure it. The paper's link has 0.038."""
STAMP_NS = 1_000.0
"""One sigma of the asymmetry that the two programs add: one that was just woken up stamps late. It matters on
loopback and cables (docs/accuracy.md), not on radio."""
MAX_SKEW = 1010.0 * 1e-6
MAX_WANDER = 0.5 * 1e-6 / 60e9
"""Largest skew between two clocks (1000 ppm, with room for it being counted in the other one's seconds), and
its largest change in a ns while nobody sets a clock: half a millionth in a minute."""
USUAL_WANDER = 0.05
"""One sigma of the change of the skew, as a share of MAX_WANDER: a clock in a room's air."""
ROUNDING_NS = 2.0
REACH_NS = 1e13
"""Largest change of the offset within a window, in ns."""
EAGER_SAMPLES = 300
REFRESH_NS = 100_000_000


@dataclass(frozen=True, slots=True)
class RateChange:
    """The leader's rate against the local clock changed, by so many ppm; noticed at a local time in ns."""

    local_ns: int
    ppm: float


@dataclass(frozen=True, slots=True)
class ClockSample:
    """One exchange, in ns: t0 client sends, t1 leader receives, t2 leader sends, t3 client receives.

    t0 and t3 are read off the client's local clock, t1 and t2 off the leader's.
    """

    t0_ns: int
    t1_ns: int
    t2_ns: int
    t3_ns: int

    @property
    def round_trip_ns(self) -> int:
        """Time spent on the way, both directions together, in ns."""
        return (self.t3_ns - self.t0_ns) - (self.t2_ns - self.t1_ns)

    @property
    def lower_ns(self) -> int:
        """Leader minus local time is at least this at t3, in ns."""
        return self.t2_ns - self.t3_ns

    @property
    def upper_ns(self) -> int:
        """Leader minus local time is at most this at t0, in ns."""
        return self.t1_ns - self.t0_ns

    @property
    def local_ns(self) -> int:
        """Middle of the exchange in local time, in ns."""
        return (self.t0_ns + self.t3_ns) // 2


class ClockFilter:
    """Estimates leader time from local time: the minimum delay of each direction, and the skew.

    The hard bound holds for any delays, in any order, as long as the skew stays below MAX_SKEW and changes
    by less than MAX_WANDER. The local clock must never run backwards.
    """

    def __init__(self, *, window_ns: int = 30_000_000_000) -> None:
        self._window_ns = window_ns
        self._not_before_ns: int | None = None
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        self.samples = 0
        self.rate_change: RateChange | None = None
        """The latest change of the rate that was noticed: a host's clock is being slewed, or was before."""
        self._blocks: dict[int, Block] = {}
        self._newest_ns = 0
        self._anchor_ns = 0
        self._lines = self._all_lines()
        self._reference_ns = 0
        self._fit: VotedLine | None = None
        self._excess = DelayExcess(0.0, 0.0)
        self._fitted_at_ns = 0
        self._stale = True

    def add(self, sample: ClockSample) -> bool:
        """Add a sample; False if it contradicts all earlier ones and the filter started anew with it.

        Samples with a negative round trip, far too slow ones and those older than the window are ignored.
        """
        if sample.round_trip_ns < 0 or sample.t2_ns < sample.t1_ns:
            return True
        if not 0 <= sample.t3_ns - sample.t0_ns <= self._window_ns // 2:
            return True
        if self._not_before_ns is not None and sample.t0_ns < self._not_before_ns:
            return True
        if not self._blocks:
            self._start_with(sample)
            return True
        if sample.t0_ns < self._newest_ns - self._window_ns:
            return True
        upper, lower = self._bounds(sample)
        fits = self._clip(self._lines, upper, lower)
        if fits or self._fits_latest(upper, lower):
            next_block = sample.t3_ns // BLOCK_NS > self._newest_ns // BLOCK_NS
            self._store_bounds(sample)
            if (fits and not next_block) or self._rebuild():
                return True
        # Messages of before the step may still be on their way.
        self._not_before_ns = sample.t0_ns
        self.reset()
        self._start_with(sample)
        return False

    def time_map(self, now_local_ns: int) -> TimeMap | None:
        """The map as it stands at a local time in ns, its epoch; None before the first sample."""
        if not self._blocks:
            return None
        # Later on, a line a tenth of a second old is as good as a new one.
        due = self.samples <= EAGER_SAMPLES or self._newest_ns - self._fitted_at_ns >= REFRESH_NS
        if self._fit is None or (self._stale and due):
            self._fit = self._fit_line()
            self._fitted_at_ns, self._stale = self._newest_ns, False
        fit, age = self._fit, float(now_local_ns - self._fitted_at_ns)
        t = float(now_local_ns - self._reference_ns)
        lowest, highest = self._lines.value_range_at(t)
        least, greatest = self._lines.slope_range()
        skew = min(max(fit.skew, least), greatest)
        offset_ns = round(min(max(fit.offset + fit.skew * age, lowest), highest))
        bound = max(highest - offset_ns, offset_ns - lowest) + self._slack(t)
        # The lines describe the latest samples; what the skew has changed since comes on top.
        skew_bound = max(greatest - skew, skew - least) + MAX_WANDER * (self._window_ns + abs(t))
        span = float(self._newest_ns - min(self._blocks) * BLOCK_NS)
        variance, covariance, skew_variance = fit.spread_at(age, USUAL_WANDER * MAX_WANDER, span)
        uncertainty = min(self._uncertainty(fit, variance), bound)
        skew_uncertainty = min(2.0 * sqrt(skew_variance), skew_bound)
        round_trips = [b.round_trip_ns for b in self._blocks.values() if b.round_trip_ns is not None]
        return TimeMap(
            epoch_local_ns=now_local_ns,
            offset_ns=self._anchor_ns + offset_ns,
            skew=skew,
            uncertainty_ns=uncertainty,
            hard_bound_ns=bound,
            skew_uncertainty=skew_uncertainty,
            skew_bound=skew_bound,
            samples=self.samples,
            round_trip_ns=min(round_trips, default=0),
            age_ns=max(0, now_local_ns - self._newest_ns),
            shared_uncertainty=min(max(0.0, 4.0 * covariance), uncertainty * skew_uncertainty),
        )

    def _uncertainty(self, fit: VotedLine, variance: float) -> float:
        """95 % of the error in ns: of the line (`variance`), the minimum delays and the link's asymmetry."""
        if not fit.upper:
            return fit.gap / 2.0 + 2.0 * sqrt(variance)
        unseen = (ASYMMETRY_SHARE * fit.gap / 2.0) ** 2 + STAMP_NS**2
        return radius_95(self._excess.mean, sqrt(variance + self._excess.variance + unseen))

    def _start_with(self, sample: ClockSample) -> None:
        self._newest_ns = sample.t3_ns
        self._anchor_ns = (sample.upper_ns + sample.lower_ns) // 2
        self._store_bounds(sample)
        self._rebuild()

    def _bounds(self, sample: ClockSample) -> tuple[Bound, Bound]:
        upper = (sample.t0_ns, sample.upper_ns - self._anchor_ns)
        lower = (sample.t3_ns, self._anchor_ns - sample.lower_ns)
        return upper, lower

    def _store_bounds(self, sample: ClockSample) -> None:
        """Store each of the sample's bounds in the block of its own second."""
        self.samples += 1
        self._stale = True
        self._newest_ns = max(self._newest_ns, sample.t3_ns)
        skew = self._fit.skew if self._fit else 0.0
        (sent_ns, upper), (received_ns, lower) = self._bounds(sample)
        block = self._block(sent_ns)
        block.upper.add(sent_ns, upper, skew)
        if block.round_trip_ns is None or sample.round_trip_ns < block.round_trip_ns:
            block.round_trip_ns = sample.round_trip_ns
        self._block(received_ns).lower.add(received_ns, lower, -skew)

    def _block(self, local_ns: int) -> Block:
        index = local_ns // BLOCK_NS
        block = self._blocks.get(index)
        if block is None:
            block = self._blocks[index] = Block(MAX_SKEW)
        return block

    def _all_lines(self) -> FeasibleLines:
        return FeasibleLines(lowest=-REACH_NS, highest=REACH_NS, steepest=MAX_SKEW)

    def _slack(self, t: float) -> float:
        """How far a clock can bend away from a straight line, t ns from the reference, in ns."""
        return ROUNDING_NS + MAX_WANDER * t * t / 2.0

    def _clip(self, lines: FeasibleLines, upper: Bound, lower: Bound) -> bool:
        sent, received = float(upper[0] - self._reference_ns), float(lower[0] - self._reference_ns)
        lines.bound_above(sent, upper[1] + self._slack(sent))
        return lines.bound_below(received, -lower[1] - self._slack(received))

    def _clip_block(self, lines: FeasibleLines, block: Block) -> bool:
        for at_ns, value in block.upper.points:
            t = float(at_ns - self._reference_ns)
            lines.bound_above(t, value + self._slack(t))
        for at_ns, value in block.lower.points:
            t = float(at_ns - self._reference_ns)
            lines.bound_below(t, -value - self._slack(t))
        return not lines.empty

    def _fits_latest(self, upper: Bound, lower: Bound) -> bool:
        """Whether some line fits the bounds and the latest two seconds; if not, the clock stepped."""
        lines = self._all_lines()
        self._clip(lines, upper, lower)
        return all(self._clip_block(lines, self._blocks[i]) for i in sorted(self._blocks)[-2:])

    def _rebuild(self) -> bool:
        """Clip anew from the latest second back, as far as some line fits; False if none fits any.

        Older seconds are dropped: a clock wanders slowly with its temperature.
        """
        oldest = (self._newest_ns - self._window_ns) // BLOCK_NS
        self._reference_ns = self._newest_ns
        self._lines = self._all_lines()
        kept: dict[int, Block] = {}
        for index in sorted(self._blocks, reverse=True):
            if index < self._newest_ns // BLOCK_NS:
                self._blocks[index].settle()
            before = self._lines.corners
            if index < oldest or not self._clip_block(self._lines, self._blocks[index]):
                self._lines.corners = before
                break
            kept[index] = self._blocks[index]
        bent = any(oldest <= index < min(kept, default=oldest) for index in self._blocks)
        self._blocks = kept
        # A bound from one side only is no estimate.
        sides = kept.values()
        if not (any(b.upper.points for b in sides) and any(b.lower.points for b in sides)):
            return False
        if bent:
            skew = self._fit.skew if self._fit is not None else 0.0
            self._fit, self._fitted_at_ns = self._fit_line(), self._newest_ns
            self.rate_change = RateChange(self._newest_ns, (self._fit.skew - skew) * 1e6)
        return True

    def _fit_line(self) -> VotedLine:
        """Fit the line anew, and estimate how far the least delays measured lie above the minimum delays."""
        ref_ns, blocks = self._newest_ns, self._blocks.values()
        uppers, lowers = [b.upper for b in blocks], [b.lower for b in blocks]

        def points(sides: list[OneWayBounds]) -> list[Point]:
            return [(float(t - ref_ns), float(v)) for side in sides for t, v in side.points]

        def tightest(sides: list[OneWayBounds], skew: float) -> list[float]:
            return [v - skew * (t - ref_ns) for side in sides for _, (t, v) in side.tightest]

        fit = vote_on_skews(
            points(uppers),
            points(lowers),
            lambda skew: (tightest(uppers, skew), tightest(lowers, -skew)),
            steepest=MAX_SKEW,
            count=RUNNERS_UP,
        )
        there, back = estimate_excess(fit.upper), estimate_excess(fit.lower)
        self._excess = DelayExcess((there.mean - back.mean) / 2.0, (there.variance + back.variance) / 4.0)
        return fit
