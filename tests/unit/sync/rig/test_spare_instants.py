"""Bursts of cameras that drop frames, in virtual time: spare instants, long bursts, and cancelled ones."""

from dataclasses import replace
from typing import Any

import pytest

from benchmarks.simulated.virtual_rig import NodeSpec, VirtualNode, VirtualRig
from capture_app.common.clock import SimulatedClock
from capture_app.node.burst.plans import choose_instants
from capture_app.node.camera.burst_upload import Upload
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.protocol.event_text import client_record
from capture_app.protocol.messages import CameraReport
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import CameraRecord
from capture_app.sync.rig.events import TriggerCancelled
from capture_app.sync.rig.frame_selection import Burst, FramesSelected
from tests.unit.sync.rig.rigs import LAN, S, ready_rig


def dropping_rig(cameras: int, drop_fraction: float, seed: int = 1) -> VirtualRig:
    profile = replace(PROFILES["perfect"], drop_fraction=drop_fraction)
    return ready_rig(
        [NodeSpec(f"cam{n}", profile, SimulatedClock(n * S), LAN) for n in range(cameras)], seed=seed
    )


def shares_of(node: VirtualNode, burst: Burst) -> CameraPlan | None:
    picked: Any = node.bursts.get(burst.number)
    if picked is None:
        return None
    plan = CameraPlan(camera=CameraRecord(name=node.spec.name, facts=node.client.config.camera))
    upload = Upload(CameraReport(leader=1, burst=burst.number, plan=plan))
    upload.extend(picked)
    return upload.report.plan


def take(rig: VirtualRig, frames: int, spare: int) -> tuple[Burst, tuple[int, ...]]:
    """Take a burst as a leader does: choose as soon as that is possible, and tell the nodes."""
    burst = rig.trigger(frames=frames, spare=spare)
    chosen: tuple[int, ...] | None = None

    def is_chosen() -> bool:
        nonlocal chosen
        chosen = choose_instants(
            len(burst.instants_ns), burst.frames, [shares_of(node, burst) for node in rig.nodes.values()]
        )
        return chosen is not None

    assert rig.run_until(is_chosen, limit_ns=10 * S)
    for node in rig.nodes.values():
        node.client.forget_burst(burst_leader(rig), burst.number)
    assert chosen is not None
    return burst, chosen


def burst_leader(rig: VirtualRig) -> int:
    return rig.leader.config.instance


def is_complete(rig: VirtualRig, burst: Burst, chosen: tuple[int, ...]) -> bool:
    shares = [shares_of(node, burst) for node in rig.nodes.values()]
    return all(share is not None and {*share.instants} >= {*chosen} for share in shares)


def test_a_burst_ends_when_it_is_complete() -> None:
    rig = dropping_rig(3, 0.0)
    burst, chosen = take(rig, 5, 5)
    assert chosen == (0, 1, 2, 3, 4)
    assert rig.now_true_ns < burst.instants_ns[6]
    rig.run_for(S)
    for node in rig.nodes.values():
        assert max(pick.instant for pick in node.bursts[burst.number].frames) < 7


def test_spare_instants_are_reported_one_by_one_with_the_map_of_the_first() -> None:
    rig = dropping_rig(1, 0.3)
    burst = rig.trigger(frames=10, spare=4)
    rig.run_for(3 * S)
    node = rig.nodes["cam0"]
    told = [event for event in node.events if isinstance(event, FramesSelected)]
    assert [len(event.frames) + len(event.gaps) for event in told] == [10, 1, 1, 1, 1]
    assert [event.further for event in told] == [False, True, True, True, True]
    assert len({event.time_map for event in told}) == 1
    share = shares_of(node, burst)
    assert share is not None
    assert {*share.instants, *(gap.instant for gap in share.missing)} == set(range(14))
    assert share.missing


def test_a_burst_may_be_longer_than_the_ring_buffer() -> None:
    rig = dropping_rig(1, 0.0)
    burst = rig.trigger(frames=5, spacing=30)
    rig.run_for(8 * S)
    picked = rig.nodes["cam0"].bursts[burst.number]
    assert [pick.instant for pick in picked.frames] == [0, 1, 2, 3, 4]
    for pick in picked.frames:
        assert abs(pick.frame.start_true_ns - burst.instants_ns[pick.instant]) < 150_000


@pytest.mark.parametrize("wait_ns", [0, S // 10, S])
def test_a_cancelled_burst_is_forgotten_by_all_nodes(wait_ns: int) -> None:
    rig = dropping_rig(3, 0.0)
    burst = rig.trigger(frames=10)
    rig.run_for(wait_ns)
    rig.cancel(burst)
    picked = {name for name, node in rig.nodes.items() if burst.number in node.bursts}
    assert len(picked) == (3 if wait_ns == S else 0)
    rig.run_for(3 * S)
    for name, node in rig.nodes.items():
        assert (burst.number in node.bursts) == (name in picked)
        assert node.client.state.is_aligned
        assert not node.client.has_burst_pending
        cancelled = TriggerCancelled(burst_leader(rig), burst.number)
        assert cancelled in node.events
        assert client_record(cancelled)["event"] == "burst-cancelled"
    burst, chosen = take(rig, 2, 2)
    assert is_complete(rig, burst, chosen)
