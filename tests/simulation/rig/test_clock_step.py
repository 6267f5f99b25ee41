"""A clock that jumps is noticed by the first exchange after it, in the whole engine."""

from dataclasses import replace

import pytest

from capture_app.clock import SimulatedClock
from capture_app.simulation.devices.profiles import PROFILES
from capture_app.simulation.network.delay_laws import GammaDelay
from capture_app.simulation.network.link import Link
from capture_app.simulation.network.paper_link import PAPER_LINK
from capture_app.simulation.rig.rig import NodeSpec, VirtualRig
from capture_app.sync.rig.events import ClockStepped, ClockSynced
from capture_app.sync.rig.poll_schedule import PACE_NS

MS, S = 1_000_000, 1_000_000_000
LAN = Link(GammaDelay(60_000, 90_000), GammaDelay(60_000, 90_000))


@pytest.mark.parametrize(("link", "step_ns"), [(LAN, MS), (LAN, -MS), (PAPER_LINK, 50 * MS), (LAN, 3600 * S)])
def test_a_jump_is_noticed_by_the_next_exchange_and_learned(link: Link, step_ns: int) -> None:
    clock = SimulatedClock(5 * 3600 * S, 20.0)
    rig = VirtualRig([NodeSpec("cam", PROFILES["phone-a"], clock, link)], seed=2)
    rig.run_for(5 * S)
    (node,) = rig.nodes.values()
    assert not any(isinstance(event, ClockStepped) for event in node.events)
    node.spec = replace(node.spec, clock=SimulatedClock(clock.offset_ns + step_ns, 20.0))
    stepped_true_ns = rig.now_true_ns
    assert rig.run_until(
        lambda: any(isinstance(event, ClockStepped) for event in node.events), limit_ns=2 * S
    )
    # A request may just have left, and the next is a pace away; then one round trip.
    assert rig.now_true_ns - stepped_true_ns < 2 * PACE_NS + 30 * MS
    events = len(node.events)
    assert rig.run_until(
        lambda: any(isinstance(event, ClockSynced) for event in node.events[events:]), limit_ns=5 * S
    )
    time_map = node.client.time_map
    assert time_map is not None
    local_ns = node.spec.clock.local_from_true(rig.now_true_ns)
    assert abs(time_map.leader_from_local(local_ns) - rig.now_true_ns) <= time_map.hard_bound_at(local_ns)
