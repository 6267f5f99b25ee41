"""Nodes are ready by how well they know the time, and say what keeps them from it."""

import re
from dataclasses import replace

from benchmarks.simulated.links import Link
from benchmarks.simulated.virtual_rig import NodeSpec, VirtualRig
from benchmarks.simulated.wifi_laws import LognormalDelay
from benchmarks.simulated.wireless import TroubleSpells, WirelessLink
from capture_app.common.camera_facts import PhaseControl
from capture_app.common.clock import SimulatedClock
from capture_app.common.node_state import NodeState
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.sync.timekeeping.clock_events import ClockSynced
from capture_app.sync.timekeeping.poll_schedule import FIRST_SAMPLES, MIN_EXCHANGES, POLL_INTERVAL_NS
from capture_app.sync.wire.datagrams import Report
from tests.unit.sync.rig.rigs import LAN, MS, S

BURSTY = WirelessLink(
    LognormalDelay(MS // 5, 9 * MS, 0.7, outlier_fraction=0.05),
    LognormalDelay(MS // 5, 5 * MS, 0.7, outlier_fraction=0.05),
    spells=TroubleSpells(calm_ns=S, trouble_ns=S),
)
"""WiFi in a crowded hall: half of the time nothing but stragglers and losses comes through."""


def spec(name: str, link: Link, tolerance_ns: int) -> NodeSpec:
    clock = SimulatedClock(7 * S, 30.0)
    return NodeSpec(name, PROFILES["perfect"], clock, link, tolerance_ns, clock_tolerance_ns=tolerance_ns)


def report(rig: VirtualRig, name: str) -> Report:
    return next(view.report for view in rig.leader.roster.by_name() if view.name == name)


def in_state(rig: VirtualRig, name: str, state: NodeState) -> bool:
    return name in rig.nodes and rig.nodes[name].client.state is state


def test_on_a_bursty_link_a_node_asks_on_and_says_that_the_tolerance_is_not_met() -> None:
    rig = VirtualRig([spec("far", BURSTY, 100_000), spec("near", LAN, 100_000)], seed=2)
    assert rig.run_until(lambda: in_state(rig, "near", NodeState.READY), limit_ns=4 * S)
    assert in_state(rig, "far", NodeState.SYNCING)
    assert re.fullmatch(
        rf"measuring clock \d+/{MIN_EXCHANGES}|clock error .* so far, .*", report(rig, "far").message
    )
    assert rig.run_until(lambda: in_state(rig, "far", NodeState.DEGRADED), limit_ns=30 * S)
    synced = next(event for event in rig.nodes["far"].events if isinstance(event, ClockSynced))
    assert synced.time_map.samples > 1.5 * FIRST_SAMPLES, "it was worth while to ask on"
    coarse = lambda: report(rig, "far").state is NodeState.DEGRADED  # noqa: E731
    assert rig.run_until(coarse, limit_ns=5 * S)
    # A second of trouble may look like a longer path at first.
    assert rig.run_until(lambda: "bursty link" in report(rig, "far").message, limit_ns=10 * S)
    told = report(rig, "far")
    assert told.uncertainty_ns is not None
    assert told.uncertainty_ns > 100_000
    assert re.fullmatch(
        r"clock error ≤ [\d.]+ [µm]s, target 100 µs: bursty link;"
        r" nearer the access point, a cable, or --clock-tolerance-us \d+",
        told.message,
    )
    suggested_ns = 1000 * int(told.message.rpartition(" ")[2])
    assert told.uncertainty_ns < suggested_ns < 10 * told.uncertainty_ns
    assert report(rig, "near").state is NodeState.READY
    assert report(rig, "near").message == ""
    rig.run_for(5 * S)
    keepers = {name: node.client.timekeeper for name, node in rig.nodes.items()}
    before = {name: keeper.requests for name, keeper in keepers.items()}
    rig.run_for(2 * S)
    asked = {name: keeper.requests - before[name] for name, keeper in keepers.items()}
    steady = 2 * S / POLL_INTERVAL_NS
    assert 1.5 * steady < asked["far"] < 3 * steady, "it goes on asking more often"
    assert asked["near"] < steady / 3, "over a cable few messages are enough"


def test_a_degraded_node_takes_part_in_a_burst_with_honest_error_bars() -> None:
    rig = VirtualRig([spec("far", BURSTY, 100_000), spec("near", LAN, 100_000)], seed=3)
    assert rig.run_until(lambda: in_state(rig, "far", NodeState.DEGRADED), limit_ns=40 * S)
    burst = rig.trigger(frames=3)
    rig.run_for(3 * S)
    for node in rig.nodes.values():
        picks = node.bursts[burst.number].frames
        assert len(picks) == 3
        for pick in picks:
            assert abs(pick.leader_ns - pick.frame.start_true_ns) <= pick.hard_bound_ns
    assert rig.nodes["far"].bursts[burst.number].frames[0].uncertainty_ns > 100_000


def test_the_suggested_clock_tolerance_makes_a_node_ready_and_moves_no_frame() -> None:
    rig = VirtualRig([spec("far", BURSTY, 100_000)], seed=2)
    assert rig.run_until(lambda: in_state(rig, "far", NodeState.DEGRADED), limit_ns=30 * S)
    assert rig.run_until(lambda: "clock-tolerance" in report(rig, "far").message, limit_ns=5 * S)
    suggested_ns = 1000 * int(report(rig, "far").message.rpartition(" ")[2])
    after = VirtualRig([replace(spec("far", BURSTY, 100_000), clock_tolerance_ns=suggested_ns)], seed=2)
    assert after.run_until(after.all_ready, limit_ns=30 * S)
    told = report(after, "far")
    assert told.tolerance_ns == report(rig, "far").tolerance_ns == 100_000
    assert told.phase_error_ns is not None
    assert abs(told.phase_error_ns) <= 100_000


def test_the_same_link_is_good_enough_for_who_asks_for_less() -> None:
    rig = VirtualRig([spec("far", BURSTY, 2 * MS)], seed=2)
    assert rig.run_until(lambda: in_state(rig, "far", NodeState.READY), limit_ns=10 * S)


def test_a_burst_is_taken_while_a_node_still_asks_on() -> None:
    rig = VirtualRig([spec("far", BURSTY, 100_000)], seed=2)
    rig.run_for(S)
    keeper = rig.nodes["far"].client.timekeeper
    assert rig.run_until(lambda: keeper.time_is_known, limit_ns=10 * S)
    assert in_state(rig, "far", NodeState.SYNCING)
    burst = rig.trigger(frames=1)
    rig.run_for(2 * S)
    assert len(rig.nodes["far"].bursts[burst.number].frames) == 1


def test_a_camera_that_cannot_move_its_frames_says_where_they_lie() -> None:
    fixed = replace(PROFILES["perfect"], phase_control=PhaseControl.NONE)
    specs = [spec("cam0", LAN, 60_000), replace(spec("cam1", LAN, 60_000), start_true_ns=7 * MS)]
    rig = VirtualRig([replace(one, profile=fixed) for one in specs], seed=4)
    assert rig.run_until(rig.all_ready, limit_ns=20 * S)
    rig.run_for(2 * S)
    for name in rig.nodes:
        told = report(rig, name)
        assert told.phase_error_ns is not None
        far = abs(told.phase_error_ns) > 60_000
        assert told.message.startswith("this camera cannot move its frames, ") == far
    assert any(report(rig, name).message for name in rig.nodes)


def test_a_node_that_moves_its_frames_says_so() -> None:
    rig = VirtualRig([spec("cam", LAN, 60_000)], seed=4)
    assert rig.run_until(lambda: in_state(rig, "cam", NodeState.ALIGNING), limit_ns=4 * S)
    seen = set()
    while not rig.run_until(lambda: in_state(rig, "cam", NodeState.READY), limit_ns=50 * MS):
        local_ns = rig.nodes["cam"].spec.clock.local_from_true(rig.now_true_ns)
        seen.add(rig.nodes["cam"].client.report(local_ns).message)
    assert any(re.fullmatch(r"frames .* off the rig's instants: .*", message) for message in seen)
    assert "" not in seen
