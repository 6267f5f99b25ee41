"""Clients send their time requests in slots, not all at once; a clock that jumps is noticed by the next."""

from dataclasses import replace

import pytest

from benchmarks.simulated.links import Link
from benchmarks.simulated.virtual_rig import NodeSpec, VirtualRig
from benchmarks.simulated.wireless import PAPER_LINK
from capture_app.common.clock import SimulatedClock
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.rig.roster import van_der_corput
from capture_app.sync.timekeeping.clock_events import ClockChanged, ClockSynced
from capture_app.sync.timekeeping.poll_schedule import (
    NEAR_INTERVAL_NS,
    POLL_INTERVAL_NS,
    Progress,
    SteadySchedule,
)
from tests.unit.sync.rig.rigs import LAN, MS, S, checked_error_ns


def test_slots_are_far_from_each_other() -> None:
    for count in (2, 3, 5, 8, 11, 100):
        for first in (0, 7):
            slots = sorted(van_der_corput(first + i) for i in range(count))
            gaps = [b - a for a, b in zip(slots, [*slots[1:], slots[0] + 1.0], strict=True)]
            assert min(gaps) >= 0.25 / count


@pytest.mark.parametrize(("link", "step_ns"), [(LAN, MS), (LAN, -MS), (PAPER_LINK, 50 * MS), (LAN, 3600 * S)])
def test_a_jump_is_noticed_by_the_next_exchange_and_learned(link: Link, step_ns: int) -> None:
    clock = SimulatedClock(5 * 3600 * S, 20.0)
    rig = VirtualRig([NodeSpec("cam", PROFILES["phone-a"], clock, link)], seed=2)
    rig.run_for(5 * S)
    (node,) = rig.nodes.values()
    assert ClockChanged(jumped=True) not in node.events
    node.spec = replace(node.spec, clock=SimulatedClock(clock.offset_ns + step_ns, 20.0))
    stepped_true_ns = rig.now_true_ns
    assert rig.run_until(lambda: ClockChanged(jumped=True) in node.events, limit_ns=2 * S)
    # A request may just have left, and the next two are a pace away, or on a cable, which then asks quickly.
    pace_ns = NEAR_INTERVAL_NS if link is LAN else POLL_INTERVAL_NS
    assert rig.now_true_ns - stepped_true_ns < 2 * pace_ns + 30 * MS
    events = len(node.events)
    assert rig.run_until(
        lambda: any(isinstance(event, ClockSynced) for event in node.events[events:]), limit_ns=16 * S
    )
    checked_error_ns(node.client.time_map, node.spec.clock, rig.now_true_ns)


@pytest.mark.parametrize(("link", "per_s"), [(LAN, 10), (PAPER_LINK, 40)])
def test_a_settled_clock_asks_rarely_over_a_cable(link: Link, per_s: int) -> None:
    rig = VirtualRig([NodeSpec("cam", PROFILES["phone-a"], SimulatedClock(5 * S, 20.0), link)], seed=2)
    rig.run_for(20 * S)
    (node,) = rig.nodes.values()
    before = node.client.timekeeper.requests
    rig.run_for(10 * S)
    assert node.client.timekeeper.requests - before == pytest.approx(10 * per_s, abs=0.1 * 10 * per_s)
    checked_error_ns(node.client.time_map, node.spec.clock, rig.now_true_ns)


def test_answers_that_all_contradict_bring_one_request_at_once_an_estimate() -> None:
    schedule, map_ = SteadySchedule(), TimeMap(0, 0, 0.0, 1e4, 1e5, 0.0, 0.0, 1000, 100_000)
    progress = Progress(synced=True, samples=1000, time_map=map_)
    schedule.begin(0)
    schedule.request_sent(0, progress)
    schedule.reply_arrived(100_000, 100_000, progress)
    schedule.estimated(S, is_settled=True)
    for _ in range(2):
        schedule.request_sent(S, progress)
        schedule.contradicted(S)
        assert schedule.request_due_ns == S
        schedule.request_sent(S, progress)
        due_ns = schedule.request_due_ns
        schedule.contradicted(S)
        assert schedule.request_due_ns == due_ns > S
        schedule.estimated(S, is_settled=True)
