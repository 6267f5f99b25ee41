"""The gap of a line: what a link usually has, and what two clocks leave of it."""

import random

import pytest

from benchmarks.clock.ready_clocks import Slew, run_slew
from capture_app.sync.clock.clock_filter import ClockFilter, ClockSample
from capture_app.sync.clock.gap_watch import ALARM, GapWatch
from tests.benchmarks.simulated.clock_changes import SPELL_CASES, cable, run_case, wifi
from tests.benchmarks.simulated.link_spells import LAWS

MS, S = 10**6, 10**9


def watched(round_trip_ns: int = 1_000_000, gap_ns: float = 900_000.0) -> GapWatch:
    """A link of this minimum round trip, whose lines have had this gap for ten seconds."""
    watch = GapWatch()
    for second in range(10):
        watch.add(second * S, round_trip_ns)
        assert not watch.is_of_two_clocks(gap_ns, 1_000.0, second * S)
    return watch


def test_a_gap_smaller_than_usual_is_of_two_clocks_if_chance_cannot_explain_it() -> None:
    watch, too_small_ns = watched(), (1.0 - 1.1 * ALARM) * 900_000.0
    assert watch.is_of_two_clocks(too_small_ns, 10_000.0, 20 * S)
    assert not watch.is_of_two_clocks(too_small_ns, 100_000.0, 20 * S)
    assert not watch.is_of_two_clocks((1.0 - 0.9 * ALARM) * 900_000.0, 10_000.0, 20 * S)


def test_a_link_that_becomes_faster_is_no_changed_clock() -> None:
    watch = watched()
    watch.add(11 * S, 500_000)
    assert not watch.is_of_two_clocks(450_000.0, 1_000.0, 11 * S)
    watch = watched()
    watch.add(11 * S, 5_000_000)
    assert not watch.is_of_two_clocks(4_500_000.0, 1_000.0, 11 * S), "nor is one that becomes slower"
    assert watch.least_ns == pytest.approx(900_000.0), "its path was shorter"


def test_nothing_is_usual_before_it_was_seen() -> None:
    watch = GapWatch()
    watch.add(0, 1_000_000)
    assert not watch.is_of_two_clocks(1.0, 1.0, 0)
    assert watch.usual_ns == 0.0


@pytest.mark.parametrize("link", ["wire", pytest.param("paper", marks=pytest.mark.slow)])
def test_a_slewed_clock_is_not_ready_for_long_while_it_is_off(link: str) -> None:
    found = run_slew(link, {"wire": cable, "paper": wifi}[link], Slew(500.0, 3.0), range(1, 2), 0.0)
    assert isinstance(found["false_s"], float)
    assert found["false_s"] <= (0.5 if link == "wire" else 2.0)
    assert found["false_after_s"] == 0.0


def test_a_queue_that_fills_is_not_reported_as_a_clock_step() -> None:
    rng, channel, clock = random.Random(1), LAWS["bufferbloat"](random.Random(1)).open(), ClockFilter()
    arrivals = []
    for t0 in range(0, 15 * S, 25 * MS):
        t1 = t0 + channel.deliveries("to_leader", t0, rng)[0]
        arrivals.append((t1 + channel.deliveries("to_client", t1, rng)[0], t0, t1))
    for number, (t3, t0, t1) in enumerate(sorted(arrivals)):
        assert clock.add(ClockSample(t0, t1, t1, t3))
        if number % 4 == 0:
            clock.time_map(t3)
    assert clock.rate_changed_ns is None


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_where_no_clock_changes_none_is_reported(name: str) -> None:
    case = next(case for case in SPELL_CASES if case.name == name)
    found = run_case(case, 2, "test").figures()
    assert found["steps"] == found["rate_changes"] == 0
    assert found["hard_bound_held"] == 1.0
    assert isinstance(found["stated_95_held"], float)
    assert found["stated_95_held"] >= 0.9
