"""The hard bound, whatever network and clocks do within their limits and beyond, and its polygon of lines."""

from bisect import bisect_right

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from capture_app.sync.clock.clock_filter import ClockFilter, ClockSample
from capture_app.sync.clock.feasible_lines import FeasibleLines
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.tree.follower import WINDOW_NS

MS = 1_000_000
S = 1_000_000_000
START_NS = 10**15
PIECE_NS = 20 * S
MOST_SKEW = 1000e-6
MOST_WANDER = 0.5e-6 / 60e9
"""The filter's own limits: skew, and its change in one ns."""


class WarmingClock:
    """A leader's clock over a local one whose skew changes at another rate in each piece of 20 s."""

    def __init__(self, offset_ns: int, skew: float, rates: list[float]) -> None:
        self._rates = rates
        self._knots: list[tuple[float, float]] = [(0.0, skew)]
        for i, rate in enumerate(rates):
            gained, slope = self._knots[-1]
            # A skew that would leave its limits stays where it is.
            if abs(slope + rate * MOST_WANDER * PIECE_NS) > MOST_SKEW:
                self._rates[i] = rate = 0.0
            turn = rate * MOST_WANDER
            self._knots.append(
                (gained + slope * PIECE_NS + turn * PIECE_NS**2 / 2.0, slope + turn * PIECE_NS)
            )
        self.offset_ns = offset_ns

    def leader(self, local_ns: int) -> int:
        t = local_ns - START_NS
        starts = range(0, PIECE_NS * len(self._rates), PIECE_NS)
        piece = max(0, bisect_right(starts, t) - 1)
        gained, slope = self._knots[piece]
        turn = self._rates[piece] * MOST_WANDER
        since = t - piece * PIECE_NS
        return local_ns + self.offset_ns + round(gained + slope * since + turn * since * since / 2.0)

    def exchange(self, t0_ns: int, there_ns: int, back_ns: int) -> ClockSample:
        leaves_ns = t0_ns + there_ns
        return ClockSample(t0_ns, self.leader(leaves_ns), self.leader(leaves_ns), leaves_ns + back_ns)


short = st.one_of(st.just(0), st.integers(0, 200_000))
delays = st.one_of(short, st.integers(0, 2 * S))
DISGUISED_NS = 1_000_000
"""A smaller step may pass for a skew that was not known yet."""
exchanges = st.lists(st.tuples(st.integers(0, 290 * S), delays, delays), min_size=2, max_size=40)
skews = st.one_of(st.sampled_from((-MOST_SKEW, 0.0, MOST_SKEW)), st.floats(-MOST_SKEW, MOST_SKEW))
waits = st.integers(0, 60 * S)
rates = st.lists(st.one_of(st.sampled_from((-1.0, 0.0, 1.0)), st.floats(-1.0, 1.0)), min_size=16, max_size=16)


@settings(max_examples=120, deadline=None)
@given(
    exchanges=exchanges,
    skew=skews,
    rates=rates,
    window_ns=st.sampled_from((30 * S, WINDOW_NS)),
    ahead_ns=st.integers(0, 60 * S),
)
@example(  # the whole limit, used in one direction for the whole window, over a link without any delay
    exchanges=[(t * S, 0, 0) for t in range(0, 290, 10)],
    skew=-40e-6,
    rates=[1.0] * 16,
    window_ns=WINDOW_NS,
    ahead_ns=30 * S,
)
def test_it_holds_for_skew_and_wander_up_to_their_limits(
    exchanges: list[tuple[int, int, int]], skew: float, rates: list[float], window_ns: int, ahead_ns: int
) -> None:
    link = WarmingClock(-(10**14), skew, [rate * 0.999 for rate in rates])
    samples = [link.exchange(START_NS + t, there, back) for t, there, back in exchanges]
    clock = ClockFilter(window_ns=window_ns)
    for sample in sorted(samples, key=lambda s: s.t3_ns):
        assert clock.add(sample), "nothing stepped"
        for at_ns in (sample.t3_ns, sample.t3_ns + ahead_ns):
            time_map = clock.time_map(at_ns)
            if time_map is None:  # the skew alone can make a round trip of nothing negative
                continue
            error_ns = abs(time_map.leader_from_local(at_ns) - link.leader(at_ns))
            assert error_ns <= time_map.hard_bound_ns + 2
            assert 0.0 <= time_map.uncertainty_ns <= time_map.hard_bound_ns
            later_ns = at_ns + ahead_ns
            error_ns = abs(time_map.leader_from_local(later_ns) - link.leader(later_ns))
            assert error_ns <= time_map.hard_bound_at(later_ns) + 2
            assert time_map.uncertainty_at(later_ns) <= time_map.hard_bound_at(later_ns)


@settings(max_examples=60, deadline=None)
@given(
    before=st.lists(st.tuples(short, short), min_size=2, max_size=30),
    after=st.lists(st.tuples(delays, delays), min_size=1, max_size=30),
    skew=skews,
    step_ns=st.integers(-(10**13), 10**13),
    pause_ns=st.sampled_from((MS, 300 * MS, 1100 * MS)),
)
def test_a_step_is_noticed_at_once_and_the_bound_is_that_of_the_new_clock(
    before: list[tuple[int, int]], after: list[tuple[int, int]], skew: float, step_ns: int, pause_ns: int
) -> None:
    link = WarmingClock(10**12, skew * 0.999, [0.0] * 16)
    clock, t_ns = ClockFilter(), START_NS
    for there, back in before:
        sample = link.exchange(t_ns, there, back)
        clock.add(sample)
        t_ns = sample.t3_ns + pause_ns
    time_map = clock.time_map(t_ns)
    if time_map is None:
        return
    link.offset_ns += step_ns
    first = link.exchange(t_ns, *after[0])
    room_ns = 2.0 * time_map.hard_bound_at(first.t3_ns) + first.round_trip_ns
    if (
        abs(step_ns) <= room_ns + DISGUISED_NS
        or first.round_trip_ns < 0
        or first.t3_ns - first.t0_ns > 15 * S
    ):
        return
    assert not clock.add(first), "no line fits both"
    assert clock.samples == 1
    t_ns = first.t3_ns + pause_ns
    for there, back in after[1:]:
        sample = link.exchange(t_ns, there, back)
        assert clock.add(sample), "it stepped only once"
        t_ns = sample.t3_ns + pause_ns
        judged = clock.time_map(t_ns)
        assert judged is not None
        assert abs(judged.leader_from_local(t_ns) - link.leader(t_ns)) <= judged.hard_bound_ns + 2


@settings(max_examples=40)
@given(st.floats(0.0, 1e6), st.floats(0.0, 1e-4), st.floats(0.0, 1.0), st.integers(-100 * S, 100 * S))
def test_the_uncertainty_ahead_lies_between_independent_and_shared_errors(
    uncertainty_ns: float, skew_uncertainty: float, share: float, ahead_ns: int
) -> None:
    shared = share * uncertainty_ns * skew_uncertainty
    time_map = TimeMap(
        0, 0, 0.0, uncertainty_ns, 1e9, skew_uncertainty, 1e-3, 1, 1, shared_uncertainty=shared
    )
    apart = skew_uncertainty * abs(ahead_ns)
    stated = time_map.uncertainty_at(ahead_ns)
    assert stated <= (uncertainty_ns + apart) * (1.0 + 1e-9)
    assert stated >= (uncertainty_ns**2 + apart**2) ** 0.5 * (1.0 - 1e-9)
    assert time_map.uncertainty_at(0) == pytest.approx(uncertainty_ns)


@settings(max_examples=40)
@given(st.floats(1.0, 1e5), st.floats(1e-9, 1e-5), st.floats(0.0, 1.0), waits, waits)
def test_errors_of_two_links_add_in_squares_ahead_too(
    uncertainty_ns: float, skew_uncertainty: float, share: float, since_ns: int, ahead_ns: int
) -> None:
    shared = share * uncertainty_ns * skew_uncertainty
    own = TimeMap(since_ns, 0, 0.0, 2e4, 1e12, 3e-7, 1e-3, 1, 1, shared_uncertainty=1e-4)
    onward = TimeMap(
        0, 5 * S, 0.0, uncertainty_ns, 1e12, skew_uncertainty, 1e-3, 1, 1, shared_uncertainty=shared
    )
    at_ns = since_ns + ahead_ns
    apart = (own.uncertainty_at(at_ns) ** 2 + onward.uncertainty_at(at_ns) ** 2) ** 0.5
    assert own.chained_to(onward).uncertainty_at(at_ns) == pytest.approx(apart, rel=1e-6)


def box() -> FeasibleLines:
    return FeasibleLines(lowest=-10.0, highest=10.0, steepest=1.0)


def test_bounds_at_two_times_leave_a_range_in_between_and_a_wider_one_outside() -> None:
    lines = box()
    for t in (-4.0, 4.0):
        assert lines.bound_below(t, -1.0)
        assert lines.bound_above(t, 1.0)
    assert lines.value_range_at(0.0) == (-1.0, 1.0)
    assert lines.value_range_at(8.0) == (-2.0, 2.0)
    assert lines.slope_range() == (-0.25, 0.25)


def test_bounds_that_contradict_each_other_leave_nothing() -> None:
    lines = box()
    assert lines.bound_below(0.0, 2.0)
    assert not lines.bound_above(0.0, 1.0)
    assert lines.empty
    assert not lines.bound_above(0.0, 5.0)


coordinate = st.floats(-100, 100)


@given(st.floats(-9, 9), st.floats(-1, 1), st.lists(st.tuples(coordinate, st.floats(0, 50), st.booleans())))
def test_a_line_that_respects_every_bound_stays_inside(
    value: float, slope: float, bounds: list[tuple[float, float, bool]]
) -> None:
    lines = box()
    for t, room, above in bounds:
        at = value + slope * t
        assert lines.bound_above(t, at + room + 1e-6) if above else lines.bound_below(t, at - room - 1e-6)
    for t in (-50.0, 0.0, 50.0):
        low, high = lines.value_range_at(t)
        assert low - 1e-3 <= value + slope * t <= high + 1e-3
