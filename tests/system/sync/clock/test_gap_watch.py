"""The gap of a line: what two clocks leave of it, and what a path does."""

import random

import pytest

from benchmarks.clock.clock_changes import SPELL_CASES, cable, run_case, wifi
from benchmarks.clock.ready_clocks import Slew, run_slew
from benchmarks.simulated.link_spells import LAWS
from capture_app.sync.clock.clock_filter import ClockFilter, ClockSample
from tests.unit.sync.clock.test_gap_watch import MS, S


def test_a_path_that_becomes_faster_is_not_reported_as_a_changed_clock() -> None:
    rng, clock = random.Random(1), ClockFilter()
    for t0 in range(0, 40 * S, 25 * MS):
        base = 1.0 * MS if t0 < 20 * S else 0.5 * MS
        t1 = t0 + round(base + rng.expovariate(1.0 / MS))
        t3 = t1 + round(base + rng.expovariate(1.0 / MS))
        assert clock.add(ClockSample(t0, t1, t1, t3))
        clock.time_map(t3)
    assert clock.changes.rate_changed_ns is None
    time_map = clock.time_map(40 * S)
    assert time_map is not None
    assert time_map.skew_uncertainty < 5e-6, "samples were removed"


@pytest.mark.parametrize("name", LAWS)
def test_where_no_clock_changes_none_is_reported(name: str) -> None:
    case = next(case for case in SPELL_CASES if case.name == name)
    found = run_case(case, 2, "test").figures()
    assert found["steps"] == found["rate_changes"] == 0
    assert found["hard_bound_held"] == 1.0
    assert isinstance(found["stated_95_held"], float)
    assert found["stated_95_held"] >= 0.9


@pytest.mark.parametrize("link", ["wire", "paper"])
def test_a_slewed_clock_is_not_ready_for_long_while_it_is_off(link: str) -> None:
    found = run_slew(link, {"wire": cable, "paper": wifi}[link], Slew(500.0, 3.0), range(1, 2), 0.0)
    assert isinstance(found["false_s"], float)
    assert found["false_s"] <= (0.5 if link == "wire" else 2.0)
    assert isinstance(found["false_after_s"], float)
    assert found["false_after_s"] <= 0.5
