"""Goals that the leader moves to suit some, and exposure centres, through the real messages."""

import random
from dataclasses import replace

from benchmarks.simulated.links import Link
from benchmarks.simulated.virtual_rig import NodeSpec, VirtualRig
from benchmarks.simulated.wireless import GammaDelay
from capture_app.common.clock import SimulatedClock
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.plugins.cameras.sim.sensor import SensorFrame
from capture_app.sync.rig.events import PhaseCorrected
from capture_app.sync.rig.frame_selection import SelectedFrame
from capture_app.sync.wire.camera_commands import RestartStream
from tests.unit.sync.rig.rigs import S, ready_rig

WIRED = Link(GammaDelay(50_000, 70_000), GammaDelay(50_000, 70_000))


def node(name: str, profile: str, tolerance_ns: int, *, exposure_ns: int | None = None) -> NodeSpec:
    rng = random.Random(name)
    clock = SimulatedClock(rng.randrange(-9 * 3600 * S, 9 * 3600 * S), rng.uniform(-20, 20))
    made = PROFILES[profile]
    if exposure_ns is not None:
        made = replace(made, exposure_ns=exposure_ns)
    return NodeSpec(name, made, clock, WIRED, tolerance_ns)


def restarts(rig: VirtualRig, name: str) -> int:
    events = rig.nodes[name].events
    return sum(isinstance(e, PhaseCorrected) and isinstance(e.command, RestartStream) for e in events)


def test_a_phone_follows_a_webcam_that_is_never_restarted() -> None:
    rig = ready_rig([node("phone", "phone-a", 60_000), node("webcam", "webcam", 1_000_000)], seed=5)
    assert restarts(rig, "webcam") == 0
    burst = rig.trigger(frames=2)
    rig.run_for(3 * S)
    for made in rig.nodes.values():
        for pick in made.bursts[burst.number].frames:
            off_ns = pick.frame.start_true_ns - burst.instants_ns[pick.instant]
            assert abs(off_ns) <= made.client.config.phase_tolerance_ns + 40_000


def middle_true_ns(rig: VirtualRig, name: str, pick: SelectedFrame[SensorFrame]) -> int:
    profile = rig.nodes[name].spec.profile
    row = round(0.5 * (profile.image_rows - 1))
    return pick.frame.start_true_ns + row * profile.row_time_ns + pick.frame.exposure_ns // 2


def test_exposure_centres_meet_where_it_is_asked_for() -> None:
    specs = [
        node("short", "phone-b", 40_000, exposure_ns=1_000_000),
        node("long", "phone-a", 40_000, exposure_ns=9_000_000),
    ]
    rig = ready_rig(specs, seed=9, align_row=0.5)
    rig.run_for(5 * S)
    burst = rig.trigger(frames=1)
    rig.run_for(4 * S)
    picks = {name: n.bursts[burst.number].frames[0] for name, n in rig.nodes.items()}
    for name, pick in picks.items():
        off_ns = middle_true_ns(rig, name, pick) - burst.instants_ns[0]
        assert abs(off_ns) < 100_000
        assert abs(pick.residual_ns - off_ns) < 60_000
        assert pick.residual_ns == pick.leader_ns - burst.instants_ns[0]
        assert abs(pick.stamp_leader_ns - pick.frame.start_true_ns) < 60_000
    first_rows = [pick.frame.start_true_ns for pick in picks.values()]
    assert abs(first_rows[0] - first_rows[1]) > 3_000_000, "the first rows must not meet then"


def test_a_known_device_is_moved_once_and_a_realigned_one_moves_no_other() -> None:
    rig = ready_rig([node("one", "pi", 60_000), node("other", "pi", 60_000)], seed=3)
    before = {name: n.client.aligner.corrections for name, n in rig.nodes.items()}
    hurt = rig.nodes["one"]
    hurt.sensor.set_frame_duration(40_000_000, rig.now_true_ns)
    rig.run_for(S)
    assert rig.run_until(rig.all_ready, limit_ns=20 * S)
    assert hurt.client.aligner.corrections == before["one"] + 1
    assert rig.nodes["other"].client.aligner.corrections == before["other"]
