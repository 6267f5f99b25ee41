"""Rigs with clocks that no ordinary crystal has: virtual machines, and hosts that are being slewed."""

import pytest

from benchmarks.simulated.virtual_rig import NodeSpec, VirtualRig
from capture_app.common.clock import SimulatedClock
from capture_app.node.leader.readiness import review_rates, rig_advice
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.sync.timekeeping.clock_events import ClockRateUnusual
from capture_app.sync.timekeeping.rates import RateVote
from tests.unit.sync.rig.rigs import LAN, S, ready_rig


def advice(rig: VirtualRig) -> str:
    vote, views = RateVote(), rig.leader.roster.by_name()
    review_rates(vote, views)
    return rig_advice(views, "10.0.0.1:47010", rig.now_true_ns, vote.off)


def lan_rig(*skews_ppm: float) -> VirtualRig:
    specs = [
        NodeSpec(f"cam{n}", PROFILES["perfect"], SimulatedClock(n * S, ppm), LAN)
        for n, ppm in enumerate(skews_ppm)
    ]
    rig = ready_rig(specs, seed=2)
    rig.run_for(6 * S)
    return rig


def test_a_fast_clock_is_named_to_the_user_by_its_node_and_by_the_rig() -> None:
    rig = lan_rig(10.0, 210.0, -30.0)
    node = rig.nodes["cam1"]
    (event,) = [event for event in node.events if isinstance(event, ClockRateUnusual)]
    assert event.fast_ppm == pytest.approx(210.0, abs=10.0)
    report = next(view.report for view in rig.leader.roster.by_name() if view.name == "cam1")
    assert report.message.startswith(
        "its clock runs 210 ppm fast against the leader's: an NTP daemon is slewing"
    )
    assert advice(rig).startswith("the clock of cam1 runs 210 ppm fast against all others: its NTP daemon")
    others = [rig.nodes[name] for name in ("cam0", "cam2")]
    assert not any(isinstance(event, ClockRateUnusual) for other in others for event in other.events)


def test_a_leader_whose_clock_is_slewed_is_named_where_all_nodes_agree() -> None:
    assert advice(lan_rig(-200.0, -215.0, -190.0)).startswith("the clock of the leader runs 2")


def test_of_two_hosts_nobody_says_for_sure_which_one_it_is() -> None:
    assert advice(lan_rig(210.0)).endswith("(or the leader's clock is)")
