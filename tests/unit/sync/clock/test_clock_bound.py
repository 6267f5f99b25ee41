"""The hard bound, whatever the network does and the clocks do within their limits, and beyond."""

from bisect import bisect_right

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_app.sync.clock.clock_filter import STEP_SAMPLES, ClockFilter, ClockSample
from capture_app.sync.clock.likely_line import DRIFT
from capture_app.sync.clock.time_map import CRYSTALS_95, TimeMap

MS = 1_000_000
S = 1_000_000_000
START_NS = 10**15
PIECE_NS = 20 * S
MOST_SKEW = 1000e-6
"""The limit that the bound rests on."""


class RestlessClock:
    """A leader's clock over a local one whose skew changes in a moment, every 20 s."""

    def __init__(self, offset_ns: int, skews: list[float]) -> None:
        self._skews = skews
        self.offset_ns = offset_ns
        self._gained = [0.0]
        for skew in skews:
            self._gained.append(self._gained[-1] + skew * PIECE_NS)

    def leader(self, local_ns: int) -> int:
        t = local_ns - START_NS
        starts = range(0, PIECE_NS * len(self._skews), PIECE_NS)
        piece = max(0, bisect_right(starts, t) - 1)
        return (
            local_ns
            + self.offset_ns
            + round(self._gained[piece] + self._skews[piece] * (t - piece * PIECE_NS))
        )

    def exchange(self, t0_ns: int, there_ns: int, back_ns: int) -> ClockSample:
        leaves_ns = t0_ns + there_ns
        return ClockSample(t0_ns, self.leader(leaves_ns), self.leader(leaves_ns), leaves_ns + back_ns)


short = st.one_of(st.just(0), st.integers(0, 200_000))
delays = st.one_of(short, st.integers(0, 2 * S))
DISGUISED_NS = 1_000_000
"""A smaller step may pass for a skew that was not known yet."""
skews = st.one_of(st.sampled_from((-MOST_SKEW, 0.0, MOST_SKEW)), st.floats(-MOST_SKEW, MOST_SKEW))
waits = st.integers(0, 60 * S)


@settings(max_examples=60, deadline=None)
@given(
    before=st.lists(st.tuples(short, short), min_size=2, max_size=30),
    after=st.lists(st.tuples(delays, delays), min_size=STEP_SAMPLES, max_size=30),
    skew=skews,
    step_ns=st.integers(-(10**13), 10**13),
    pause_ns=st.sampled_from((MS, 300 * MS, 1100 * MS)),
)
def test_a_step_is_noticed_by_the_third_sample_and_the_bound_is_that_of_the_new_clock(
    before: list[tuple[int, int]], after: list[tuple[int, int]], skew: float, step_ns: int, pause_ns: int
) -> None:
    link = RestlessClock(10**12, [skew * 0.999] * 16)
    clock, t_ns = ClockFilter(), START_NS
    for there, back in before:
        sample = link.exchange(t_ns, there, back)
        clock.add(sample)
        t_ns = sample.t3_ns + pause_ns
    time_map = clock.time_map(t_ns)
    if time_map is None:
        return
    link.offset_ns += step_ns
    samples = clock.samples
    for number, (there, back) in enumerate(after[:STEP_SAMPLES], 1):
        sample = link.exchange(t_ns, there, back)
        room_ns = 2.0 * time_map.hard_bound_at(sample.t3_ns) + sample.round_trip_ns
        if (
            abs(step_ns) <= room_ns + DISGUISED_NS
            or sample.round_trip_ns < 0
            or sample.t3_ns - sample.t0_ns > 15 * S
        ):
            return
        assert clock.add(sample) is (number < STEP_SAMPLES), "no line fits both"
        assert clock.samples == (samples if number < STEP_SAMPLES else STEP_SAMPLES)
        t_ns = sample.t3_ns + pause_ns
    for there, back in after[STEP_SAMPLES:]:
        sample = link.exchange(t_ns, there, back)
        assert clock.add(sample), "it stepped only once"
        t_ns = sample.t3_ns + pause_ns
        judged = clock.time_map(t_ns)
        assert judged is not None
        assert abs(judged.leader_from_local(t_ns) - link.leader(t_ns)) <= judged.hard_bound_ns + 2


@settings(max_examples=40)
@given(st.floats(0.0, 1e6), st.floats(0.0, 1e-4), st.floats(0.0, 1e-15), st.integers(-100 * S, 100 * S))
def test_the_uncertainty_grows_with_the_errors_of_skew_and_drift(
    uncertainty_ns: float, skew_uncertainty: float, drift: float, away_ns: int
) -> None:
    time_map = TimeMap(0, 0, 0.0, uncertainty_ns, 1e18, skew_uncertainty, 1e-3, 1, 1, drift_uncertainty=drift)
    away, limit = abs(away_ns), max(skew_uncertainty, CRYSTALS_95)
    drifting = min(away, (limit - skew_uncertainty) / drift) if drift else away
    stated = uncertainty_ns + skew_uncertainty * away + drift * drifting * (away - drifting / 2.0)
    assert time_map.uncertainty_at(away_ns) == pytest.approx(stated)
    assert time_map.uncertainty_at(0) == pytest.approx(uncertainty_ns)


def test_an_hour_of_holdover_is_limited_by_what_crystals_do() -> None:
    drift = 1.96 * DRIFT
    time_map = TimeMap(0, 0, 0.0, 2e4, 1e6, 3e-7, 1e-3, 1, 1, drift_uncertainty=drift)
    assert time_map.uncertainty_at(60 * S) == pytest.approx(2e4 + 3e-7 * 60 * S + drift * (60 * S) ** 2 / 2)
    warmed_up_ns = 10e-6 * 3600 * S  # a crystal whose rate has changed by 10 ppm at once
    assert warmed_up_ns < time_map.uncertainty_at(3600 * S) <= 180 * MS


@settings(max_examples=40)
@given(st.floats(1.0, 1e5), st.floats(1e-9, 1e-5), st.floats(0.0, 1e-16), waits, waits)
def test_errors_of_two_links_add_in_squares_at_once_and_a_little_more_later(
    uncertainty_ns: float, skew_uncertainty: float, drift: float, since_ns: int, ahead_ns: int
) -> None:
    own = TimeMap(since_ns, 0, 0.0, 2e4, 1e12, 3e-7, 1e-3, 1, 1, drift_uncertainty=1e-17)
    onward = TimeMap(
        0, 5 * S, 0.0, uncertainty_ns, 1e12, skew_uncertainty, 1e-3, 1, 1, drift_uncertainty=drift
    )
    both = own.chained_to(onward)

    def apart(at_ns: int) -> float:
        return (own.uncertainty_at(at_ns) ** 2 + onward.uncertainty_at(at_ns) ** 2) ** 0.5

    assert both.uncertainty_at(since_ns) == pytest.approx(apart(since_ns), rel=1e-6)
    later_ns = since_ns + ahead_ns
    assert apart(later_ns) * (1 - 1e-6) <= both.uncertainty_at(later_ns) <= 1.5 * apart(later_ns)
