"""Clients send their time requests in slots, not all at once; a clock that jumps is noticed by the next."""

import random
from functools import partial

import pytest

from benchmarks.simulated.links import Channel, Direction, Link
from benchmarks.simulated.virtual_rig import NodeSpec, VirtualRig
from capture_app.common.clock import SimulatedClock
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.sync.timekeeping.poll_schedule import FIRST_INTERVAL_NS, POLL_INTERVAL_NS, SteadySchedule
from tests.unit.sync.rig.rigs import LAN, S


class Recorder:
    """A link that notes when this node sends."""

    def __init__(self, link: Link) -> None:
        self._channel: Channel = link.open()
        self.sent_true_ns: list[int] = []

    def deliveries(self, direction: Direction, true_ns: int, rng: random.Random) -> list[int]:
        if direction == "to_leader":
            self.sent_true_ns.append(true_ns)
        return self._channel.deliveries(direction, true_ns, rng)


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
