"""The hard bound, whatever the network does and the clocks do within their limits, and beyond."""

from hypothesis import example, given, settings
from hypothesis import strategies as st

from capture_app.sync.clock.clock_filter import ClockFilter
from capture_app.sync.tree.member import LONGEST_NS
from tests.unit.sync.clock.test_clock_bound import MOST_SKEW, START_NS, RestlessClock, S, delays, skews

exchanges = st.lists(st.tuples(st.integers(0, 290 * S), delays, delays), min_size=2, max_size=40)


@settings(max_examples=150, deadline=None)
@given(
    exchanges=exchanges,
    skews=st.lists(skews, min_size=16, max_size=16),
    window_ns=st.sampled_from((30 * S, LONGEST_NS)),
    ahead_ns=st.integers(0, 60 * S),
)
@example(  # a slewed leader, from before to after, over a link without any delay
    exchanges=[(t * S, 0, 0) for t in range(0, 290, 2)],
    skews=[20e-6] * 5 + [520e-6] * 5 + [20e-6] * 6,
    window_ns=30 * S,
    ahead_ns=30 * S,
)
@example(  # the whole limit, one way and the other
    exchanges=[(t * S, 0, 0) for t in range(0, 290, 10)],
    skews=[MOST_SKEW, -MOST_SKEW] * 8,
    window_ns=LONGEST_NS,
    ahead_ns=30 * S,
)
def test_it_holds_for_any_delays_and_any_rates_up_to_the_limit(
    exchanges: list[tuple[int, int, int]], skews: list[float], window_ns: int, ahead_ns: int
) -> None:
    link = RestlessClock(-(10**14), skews)
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
