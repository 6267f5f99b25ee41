"""Clients send their time requests in slots that the leader hands out, not all at once."""

import random
from functools import partial

import pytest

from capture_app.clock import SimulatedClock
from capture_app.simulation.devices.profiles import PROFILES
from capture_app.simulation.network.delay_laws import GammaDelay
from capture_app.simulation.network.link import Channel, Direction, Link
from capture_app.simulation.rig.rig import NodeSpec, VirtualRig
from capture_app.sync.rig.poll_schedule import FIRST_PACE_NS, PACE_NS, SteadySchedule
from capture_app.sync.rig.roster import van_der_corput

S = 1_000_000_000
LAN = Link(GammaDelay(60_000, 90_000), GammaDelay(60_000, 90_000))


class Recorder(Channel):
    """A link that notes when this node sends."""

    def __init__(self, link: Link) -> None:
        super().__init__(link)
        self.sent_true_ns: list[int] = []

    def deliveries(self, direction: Direction, true_ns: int, rng: random.Random) -> list[int]:
        if direction == "to_leader":
            self.sent_true_ns.append(true_ns)
        return super().deliveries(direction, true_ns, rng)


def test_slots_are_far_from_each_other() -> None:
    for count in (2, 3, 5, 8, 11, 100):
        for first in (0, 7):
            slots = sorted(van_der_corput(first + i) for i in range(count))
            gaps = [b - a for a, b in zip(slots, [*slots[1:], slots[0] + 1.0], strict=True)]
            assert min(gaps) >= 0.25 / count


@pytest.mark.parametrize(("pace_ns", "reached_s"), [(PACE_NS, 5.0), (FIRST_PACE_NS, 1.5)])
def test_clients_that_join_together_do_not_send_together(pace_ns: int, reached_s: float) -> None:
    rng = random.Random(3)
    specs = [
        NodeSpec(
            f"cam{i}",
            PROFILES["phone-a"],
            SimulatedClock(rng.randrange(10**13), rng.gauss(0, 20)),
            LAN,
            schedule=partial(SteadySchedule, pace_ns=pace_ns, near_ns=0),
        )
        for i in range(8)
    ]
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
        turns = sorted((t % pace_ns) / pace_ns for t in recorder.sent_true_ns)
        phases.append(turns[len(turns) // 2])
    phases.sort()
    gaps = [b - a for a, b in zip(phases, [*phases[1:], phases[0] + 1.0], strict=True)]
    assert min(gaps) > 0.06, phases
