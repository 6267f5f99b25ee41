"""Clients send their time requests in slots, not all at once; a clock that jumps is noticed by the next."""

import random
from dataclasses import replace
from functools import partial

import pytest

from benchmarks.simulated.links import Channel, Direction, Link
from benchmarks.simulated.virtual_rig import NodeSpec, VirtualRig
from benchmarks.simulated.wireless import PAPER_LINK
from capture_app.common.clock import SimulatedClock
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.sync.rig.roster import van_der_corput
from capture_app.sync.timekeeping.clock_events import ClockChanged, ClockSynced
from capture_app.sync.timekeeping.poll_schedule import FIRST_INTERVAL_NS, POLL_INTERVAL_NS, SteadySchedule
from tests.sync.rig.rigs import LAN, MS, S, checked_error_ns


class Recorder:
    """A link that notes when this node sends."""

    def __init__(self, link: Link) -> None:
        self._channel: Channel = link.open()
        self.sent_true_ns: list[int] = []

    def deliveries(self, direction: Direction, true_ns: int, rng: random.Random) -> list[int]:
        if direction == "to_leader":
            self.sent_true_ns.append(true_ns)
        return self._channel.deliveries(direction, true_ns, rng)


def test_slots_are_far_from_each_other() -> None:
    for count in (2, 3, 5, 8, 11, 100):
        for first in (0, 7):
            slots = sorted(van_der_corput(first + i) for i in range(count))
            gaps = [b - a for a, b in zip(slots, [*slots[1:], slots[0] + 1.0], strict=True)]
            assert min(gaps) >= 0.25 / count


@pytest.mark.parametrize(
    ("poll_interval_ns", "reached_s"), [(POLL_INTERVAL_NS, 5.0), (FIRST_INTERVAL_NS, 1.5)]
)
def test_clients_that_join_together_do_not_send_together(poll_interval_ns: int, reached_s: float) -> None:
    rng = random.Random(3)
    clocks = [SimulatedClock(rng.randrange(10**13), rng.gauss(0, 20)) for _ in range(8)]
    schedule, phone = (
        partial(SteadySchedule, poll_interval_ns=poll_interval_ns, near_ns=0),
        PROFILES["phone-a"],
    )
    specs = [NodeSpec(f"cam{i}", phone, clock, LAN, schedule=schedule) for i, clock in enumerate(clocks)]
    rig = VirtualRig(specs, seed=4)
    rig.run_for(int(reached_s * S))
    recorders = []
    for node in rig.nodes.values():
        node.channel = recorder = Recorder(LAN)
        recorders.append(recorder)
    rig.run_for(S)
    phases = []
    for recorder in recorders:
        # Heartbeats go out of turn: the middle one is a time request's.
        turns = sorted((t % poll_interval_ns) / poll_interval_ns for t in recorder.sent_true_ns)
        phases.append(turns[len(turns) // 2])
    phases.sort()
    gaps = [b - a for a, b in zip(phases, [*phases[1:], phases[0] + 1.0], strict=True)]
    assert min(gaps) > 0.05, phases


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
    # A request may just have left, and the next is a pace away; then one round trip.
    assert rig.now_true_ns - stepped_true_ns < 2 * POLL_INTERVAL_NS + 30 * MS
    events = len(node.events)
    assert rig.run_until(
        lambda: any(isinstance(event, ClockSynced) for event in node.events[events:]), limit_ns=16 * S
    )
    checked_error_ns(node.client.time_map, node.spec.clock, rig.now_true_ns)
