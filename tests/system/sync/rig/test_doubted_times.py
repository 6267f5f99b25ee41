"""A leader that was suspended, and clocks that were slewed, in virtual time: the error bars afterwards.

The leader's clock is the truth. A frame's error is its stated time minus that clock's reading when the node's
own clock showed its timestamp; a suspended machine's clock stands still.
"""

from collections.abc import Callable
from dataclasses import replace

import pytest

from benchmarks.simulated.changing_clocks import ChangingClock, RateSpell
from benchmarks.simulated.virtual_rig import NodeSpec, VirtualNode, VirtualRig
from capture_app.common.clock import SimulatedClock
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.sync.timekeeping.clock_events import TimesDoubted
from tests.unit.sync.rig.rigs import LAN, MS, S

PERFECT = PROFILES["perfect"]


def doubts(node: VirtualNode) -> list[TimesDoubted]:
    return [event for event in node.events if isinstance(event, TimesDoubted)]


def held(rig: VirtualRig, number: int, leader_at: Callable[[int], int]) -> tuple[int, int, int]:
    """Return the frames of a burst, how many of their bars held as stated, and how many widened."""
    frames = stated = widened = 0
    for node in rig.nodes.values():
        for pick in node.bursts[number].frames:
            error_ns = abs(pick.leader_ns - leader_at(node.spec.clock.true_from_local(pick.local_ns)))
            bars_ns = [pick.uncertainty_ns] + [
                doubt.error_ns
                for doubt in doubts(node)
                if doubt.from_local_ns <= pick.local_ns <= doubt.until_local_ns
            ]
            frames += 1
            stated += error_ns <= pick.uncertainty_ns
            widened += error_ns <= max(bars_ns)
    return frames, stated, widened


@pytest.mark.parametrize("suspended_s", [1, 20])
def test_bars_of_frames_taken_while_a_leader_was_suspended_hold_afterwards(suspended_s: int) -> None:
    specs = [NodeSpec(f"cam{n}", PERFECT, SimulatedClock(n * 3600 * S, 20.0 * n), LAN) for n in range(2)]
    rig = VirtualRig(specs, seed=5)
    assert rig.run_until(rig.all_ready, limit_ns=30 * S)
    burst = rig.trigger(frames=10_000, streamed=True)
    rig.run_for(3 * S)
    fell_asleep_ns = rig.now_true_ns
    rig.suspend_leader()
    rig.run_for(suspended_s * S)
    woke_ns = rig.now_true_ns
    rig.wake_leader()
    rig.run_for(10 * S)

    def leader_at(true_ns: int) -> int:
        return true_ns - max(0, min(true_ns, woke_ns) - fell_asleep_ns)

    frames, stated, widened = held(rig, burst.number, leader_at)
    assert stated < 0.95 * frames, "otherwise this test shows nothing"
    assert widened >= 0.95 * frames
    for node in rig.nodes.values():
        (doubt,) = doubts(node)
        assert doubt.jumped
        # What was taken before the leader fell asleep is right, and is not touched.
        from_true_ns = node.spec.clock.true_from_local(doubt.from_local_ns)
        assert fell_asleep_ns - S <= from_true_ns <= fell_asleep_ns + 10 * MS
        assert doubt.error_ns == pytest.approx(suspended_s * S, rel=0.02)


@pytest.mark.parametrize(("ppm", "share"), [(500.0, 0.95), (-1500.0, 0.93)])
def test_bars_of_frames_taken_before_a_slew_was_noticed_hold_afterwards(ppm: float, share: float) -> None:
    """The second is beyond what a line may have: the clock counts as one that steps again and again."""
    slewed = ChangingClock(3600 * S, 10e-6, 0, (RateSpell(20 * S, 25 * S, ppm * 1e-6),))
    specs = [
        NodeSpec("cam0", PERFECT, SimulatedClock(0, -10.0), LAN),
        NodeSpec("cam1", PERFECT, slewed, LAN),
    ]
    rig = VirtualRig(specs, seed=6)
    rig.run_for(19 * S)
    burst = rig.trigger(frames=10_000, streamed=True)
    rig.run_for(8 * S)
    frames, stated, widened = held(rig, burst.number, lambda true_ns: true_ns)
    assert widened >= share * frames
    assert widened > stated
    assert not doubts(rig.nodes["cam0"])
    noticed = doubts(rig.nodes["cam1"])[0]
    assert slewed.true_from_local(noticed.until_local_ns) >= 20 * S


def test_a_quiet_rig_doubts_nothing() -> None:
    specs = [
        NodeSpec(f"cam{n}", replace(PROFILES["pi"]), SimulatedClock(n * S, 15.0 * n), LAN) for n in range(3)
    ]
    rig = VirtualRig(specs, seed=7)
    rig.run_for(40 * S)
    assert not [doubt for node in rig.nodes.values() for doubt in doubts(node)]
