"""A staggered rig in virtual time: its cameras take their frames one after the other, as planned."""

import random
from dataclasses import replace
from itertools import pairwise

import pytest
from msgspec.structs import replace as replaced

from benchmarks.simulated.virtual_rig import NodeSpec, VirtualRig
from capture_app.common.clock import SimulatedClock
from capture_app.common.node_state import NodeState
from capture_app.common.stagger import Stagger
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.rig.frame_selection import Burst
from capture_app.sync.rig.leader_engine import RETURN_NS, Leader, LeaderConfig
from capture_app.sync.rig.rig_config import RequestedConfig
from capture_app.sync.wire.codec import decode, encode
from capture_app.sync.wire.datagrams import (
    MAX_DELAYS,
    Goodbye,
    Heartbeat,
    HeartbeatAck,
    Hello,
    Report,
    RigConfigMessage,
    Welcome,
    camera_key,
)
from tests.facts import make_facts
from tests.unit.sync.rig.rigs import LAN, MS, S, ready_rig

PERIOD_NS = PROFILES["pi"].period_ns
TOLERANCE_NS = 100_000
SPECS = tuple(
    NodeSpec(
        f"cam{n}",
        replace(PROFILES["pi"], drop_fraction=0.0),
        SimulatedClock((n - 2) * 3600 * S, 15.0 * n - 20.0),
        LAN,
        TOLERANCE_NS,
    )
    for n in range(4)
)


def burst_of(rig: VirtualRig, frames: int = 6) -> Burst:
    burst = rig.trigger(frames=frames)
    rig.run_for(2 * S)
    return burst


def true_times_ns(rig: VirtualRig, burst: Burst) -> list[int]:
    picks = (pick for node in rig.nodes.values() if node.alive for pick in node.bursts[burst.number].frames)
    return sorted(pick.frame.start_true_ns for pick in picks)


def steps_ns(rig: VirtualRig) -> list[int]:
    return [after - before for before, after in pairwise(true_times_ns(rig, burst_of(rig)))]


def test_four_cameras_at_thirty_frames_a_second_are_one_at_120() -> None:
    rig = ready_rig(SPECS, seed=1, stagger=Stagger())
    burst = burst_of(rig)
    times_ns = true_times_ns(rig, burst)
    assert len(times_ns) == 24
    for before, after in pairwise(times_ns):
        assert abs(after - before - PERIOD_NS / 4) <= 2 * TOLERANCE_NS
    for place, node in enumerate(rig.nodes.values()):
        assert node.client.delay_ns == place * PERIOD_NS // 4
        for pick in node.bursts[burst.number].frames:
            # Told against the plan, and true.
            due_ns = burst.instants_ns[pick.instant] + node.client.delay_ns
            assert pick.residual_ns == pick.leader_ns - due_ns
            assert abs(pick.frame.start_true_ns - due_ns) <= TOLERANCE_NS


def test_a_listed_delay_is_kept_and_others_have_none() -> None:
    rig = VirtualRig(SPECS[:3], seed=1, stagger=Stagger.parse("cam1=8.3ms,cam2=40ms"))
    assert rig.run_until(rig.all_ready, limit_ns=30 * S)
    burst = burst_of(rig)
    for name, delay_ns in (("cam0", 0), ("cam1", 8_300_000), ("cam2", 40 * MS)):
        for pick in rig.nodes[name].bursts[burst.number].frames:
            assert abs(pick.frame.start_true_ns - burst.instants_ns[pick.instant] - delay_ns) <= TOLERANCE_NS


def test_the_others_close_up_when_a_camera_signs_off() -> None:
    rig = ready_rig(SPECS, seed=1, stagger=Stagger())
    node = rig.nodes["cam1"]
    assert node.client.number is not None
    rig._to_leader(encode(Goodbye(node.client.number)), node)
    rig.kill("cam1")
    rig.run_for(3 * S)
    assert [rig.nodes[name].client.delay_ns for name in ("cam0", "cam2", "cam3")] == [
        0,
        PERIOD_NS // 3,
        2 * PERIOD_NS // 3,
    ]
    for step_ns in steps_ns(rig):
        assert abs(step_ns - PERIOD_NS / 3) <= 2 * TOLERANCE_NS


def test_a_lost_camera_keeps_its_place_until_it_is_forgotten() -> None:
    rig = ready_rig(SPECS, seed=1, stagger=Stagger())
    rig.kill("cam1")
    rig.run_for(5 * S)
    assert rig.leader.roster.members["cam1"].lost
    assert rig.nodes["cam3"].client.delay_ns == 3 * PERIOD_NS // 4
    rig.leader.forget("cam1")
    rig.run_for(3 * S)
    assert rig.nodes["cam3"].client.delay_ns == 2 * PERIOD_NS // 3


def test_delays_do_not_change_during_a_burst() -> None:
    rig = ready_rig(SPECS, seed=1, stagger=Stagger())
    burst = rig.trigger(frames=60, streamed=True)
    rig.run_for(S // 2)
    node = rig.nodes["cam1"]
    assert node.client.number is not None
    rig._to_leader(encode(Goodbye(node.client.number)), node)
    rig.kill("cam1")
    rig.run_for(S)
    assert rig.nodes["cam3"].client.delay_ns == 3 * PERIOD_NS // 4
    rig.run_for(4 * S)
    assert rig.nodes["cam3"].client.delay_ns == 2 * PERIOD_NS // 3
    frames = rig.nodes["cam3"].bursts[burst.number].frames
    assert len(frames) == 60
    assert max(abs(pick.residual_ns) for pick in frames) <= TOLERANCE_NS


def test_a_configuration_that_arrives_during_a_burst_waits_for_its_end() -> None:
    rig = ready_rig(SPECS, seed=1, stagger=Stagger())
    rig.trigger(frames=30)
    rig.run_for(S)
    client = rig.nodes["cam3"].client
    assert client.has_burst_pending
    assert client.followed is not None
    assert client.number is not None
    client.receive_message(HeartbeatAck(client.number, replaced(client.followed, delays_ns={})), 0)
    assert client.delay_ns == 3 * PERIOD_NS // 4


@pytest.mark.parametrize("stagger", [Stagger(), None], ids=["planned", "no longer planned"])
def test_a_recording_goes_on_with_its_delays_though_all_were_started_again(stagger: Stagger | None) -> None:
    rig = ready_rig(SPECS[:2], seed=1, stagger=Stagger())
    burst = rig.trigger(frames=400, streamed=True)
    rig.run_for(S)
    earlier, planned_ns = rig.leader, rig.leader.planned_delays_ns()
    assert planned_ns == {"cam0": 0, "cam1": PERIOD_NS // 2}
    for spec in SPECS[:2]:
        rig.kill(spec.name)
    rig._config = replace(rig._config, rig=replace(rig._config.rig, stagger=stagger))
    rig.restart_leader()
    rig.leader.resume(burst, earlier.config.instance, planned_ns, rig.leader_ns)
    nodes = [rig.start(spec) for spec in SPECS[:2]]
    assert rig.run_until(lambda: rig.now_true_ns > burst.instants_ns[-1] + S, limit_ns=60 * S)
    for node in nodes:
        delay_ns, picked = planned_ns[node.spec.name], node.bursts[burst.number].frames
        assert picked[-1].instant == 399
        for pick in picked[60:]:
            due_ns = burst.instants_ns[pick.instant] + delay_ns
            assert abs(pick.frame.start_true_ns - due_ns) <= 2 * TOLERANCE_NS
    rig.run_for(5 * S)
    assert nodes[1].client.delay_ns == (PERIOD_NS // 2 if stagger else 0)


class TakenOver:
    """A leader that has taken over a staggered rig, and whose cameras come back one by one."""

    def __init__(self, stagger: Stagger | None = None, grid: FrameGrid | None = None) -> None:
        self.leader = Leader(
            LeaderConfig(1, 0, RequestedConfig(stagger=stagger), grid=grid), random.Random(1)
        )
        self.numbers: dict[str, int] = {}

    def join(self, name: str, now_ns: int, camera: str = "sim", via: str | None = None) -> RigConfigMessage:
        facts = replaced(make_facts(), kind=camera, period_ns=PERIOD_NS)
        return self.tell(encode(Hello(name, len(self.numbers), facts, via)), name, now_ns)

    def heartbeat(self, name: str, now_ns: int) -> RigConfigMessage:
        report = Report(state=NodeState.READY)
        return self.tell(encode(Heartbeat(self.numbers[name], report)), name, now_ns)

    def tell(self, data: bytes, name: str, now_ns: int) -> RigConfigMessage:
        """Return the configuration in the newest answer."""
        self.leader.receive_datagram(data, (name, 1), now_ns)
        self.leader.handle_timer(now_ns)
        answers = [answer for answer, (host, _) in self.leader.datagrams_to_send(now_ns) if host == name]
        newest = decode(answers[-1])
        assert isinstance(newest, Welcome | HeartbeatAck)
        self.numbers[name] = newest.client
        return newest.config


def test_cameras_of_a_lost_leader_keep_their_delays_until_all_can_have_come_back() -> None:
    rig = TakenOver(Stagger(), FrameGrid(0, PERIOD_NS))
    for name in ("cam1", "cam0"):
        assert rig.join(name, S).delays_ns is None
        assert rig.heartbeat(name, S).delays_ns is None
    for second in range(1, RETURN_NS // S):
        for name in ("cam0", "cam1"):
            assert rig.heartbeat(name, S + second * S).delays_ns is None
    for name in ("cam0", "cam1"):
        rig.heartbeat(name, S + RETURN_NS)
    assert rig.heartbeat("cam1", S + RETURN_NS).delays_ns == {camera_key("cam1"): PERIOD_NS // 2}
    assert rig.heartbeat("cam0", S + RETURN_NS).delays_ns == {}


def test_a_leader_without_the_option_puts_them_in_step_on_the_grid_that_they_are_on() -> None:
    grid = FrameGrid(7_000, PERIOD_NS)
    config = TakenOver(None, grid).join("cam1", S)
    assert config.delays_ns == {}
    assert FrameGrid(config.anchor_leader_ns, config.period_ns) == grid


def test_a_relay_is_told_of_the_cameras_below_it() -> None:
    rig = TakenOver(Stagger())
    rig.join("relay", S, camera="relay")
    for name in ("cam0", "cam1", "cam2"):
        rig.join(name, S, via=None if name == "cam0" else "relay")
        number = rig.leader.roster.members[name].number
        rig.leader.receive_datagram(encode(Heartbeat(number, Report(state=NodeState.READY))), ("x", 1), S)
    rig.leader.handle_timer(S)
    assert rig.heartbeat("relay", 2 * S).delays_ns == {
        camera_key("cam1"): PERIOD_NS // 3,
        camera_key("cam2"): 2 * PERIOD_NS // 3,
    }


def test_the_delays_of_many_cameras_fit_into_a_datagram() -> None:
    names = [f"{'x' * 60}{n:03}" for n in range(2 * MAX_DELAYS)]
    leader = Leader(LeaderConfig(1, 0), random.Random(1))
    leader.current.lay_grid(make_facts(), 0)
    leader.current.delays_ns = {camera_key(name): 10**9 for name in names}
    config = leader.current.message(0, names)
    assert config.delays_ns is not None
    assert len(config.delays_ns) == MAX_DELAYS
    assert decode(encode(HeartbeatAck(1, config))) == HeartbeatAck(1, config)
