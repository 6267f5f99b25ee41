"""Groups of answers: over pauses of every length, at any pace, and on links whose delays come in spells."""

import random

import pytest

from benchmarks.simulated.wireless import WIFI, WirelessLink
from capture_app.sync.clock.answer_groups import HALF_NS, HALF_SAMPLES, AnswerGroups
from capture_app.sync.clock.clock_filter import ClockFilter, ClockSample
from tests.benchmarks.simulated.clock_changes import SPELL_CASES, run_case
from tests.benchmarks.simulated.link_spells import LAWS, FillingQueue

MS, S = 10**6, 10**9
WINDOW_NS = 60 * S
GROUP = 2 * HALF_SAMPLES


@pytest.mark.parametrize("before", range(1, 3 * GROUP))
@pytest.mark.parametrize("pause_s", [59, 61, 3600])
def test_a_pause_longer_than_the_window_restarts_the_groups(before: int, pause_s: int) -> None:
    groups = AnswerGroups(WINDOW_NS)
    times_s = [*range(before), *range(before + pause_s, before + pause_s + 3 * GROUP)]
    whole = [groups.add((s * S, 500_000), (s * S + 1_000_000, 400_000), 0.0) for s in times_s]
    assert any(whole[-GROUP:])
    if pause_s > 60:
        assert not any(whole[before : before + GROUP - 1])  # no group is of answers from both sides


@pytest.mark.parametrize("pace_ms", [1, 3, 25])
def test_a_group_lasts_as_long_as_a_spell_at_any_pace(pace_ms: int) -> None:
    groups, complete_ns = AnswerGroups(WINDOW_NS), []
    for at_ns in range(0, 10 * S, pace_ms * MS):
        if groups.add((at_ns, 500_000), (at_ns + MS, 400_000), 0.0):
            complete_ns.append(at_ns)
    assert complete_ns[0] >= 2 * HALF_NS
    halves_s = (complete_ns[-1] - complete_ns[0]) / (len(complete_ns) - 1) / S
    assert halves_s >= HALF_NS / S


@pytest.mark.parametrize("interval_ms", [3, 25])
def test_a_queue_that_fills_is_not_reported_as_a_clock_step(interval_ms: int) -> None:
    bloated = WirelessLink(WIFI.to_leader, WIFI.to_client, spells=FillingQueue(3 * S, 2 * S))
    for seed in range(3):
        clock, channel, rng = ClockFilter(), bloated.open(), random.Random(seed)
        arrivals = []
        for t0 in range(0, 15 * S, interval_ms * MS):
            t1 = t0 + channel.deliveries("to_leader", t0, rng)[0]
            arrivals.append((t1 + channel.deliveries("to_client", t1, rng)[0], t0, t1))
        assert all(clock.add(ClockSample(t0, t1, t1, t3)) for t3, t0, t1 in sorted(arrivals))


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_where_no_clock_changes_none_is_reported(name: str) -> None:
    case = next(case for case in SPELL_CASES if case.name == name)
    found = run_case(case, 2, "test").figures()
    assert found["steps"] == 0
    assert found["hard_bound_held"] == 1.0
    assert isinstance(found["stated_95_held"], float)
    assert found["stated_95_held"] >= 0.9
