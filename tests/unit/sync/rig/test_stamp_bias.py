"""Cameras whose stamps are late, in a rig in virtual time: what their pictures' times then say."""

from dataclasses import replace

import pytest

from benchmarks.simulated.virtual_rig import NodeSpec, VirtualRig
from capture_app.common.clock import SimulatedClock
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.plugins.cameras.sim.sensor import SensorFrame
from capture_app.sync.rig.frame_selection import SelectedFrame
from tests.unit.sync.rig.rigs import LAN, MS, ready_rig


def picks(rig: VirtualRig, name: str) -> tuple[SelectedFrame[SensorFrame], ...]:
    return next(iter(rig.nodes[name].bursts.values())).frames


def shot(bias_ns: int | None) -> VirtualRig:
    late = replace(PROFILES["phone-a"], stamp_bias_ns=bias_ns, drop_fraction=0.0)
    specs = [
        NodeSpec("late", late, SimulatedClock(5 * MS, 8.0), LAN),
        NodeSpec("true", replace(PROFILES["phone-b"], drop_fraction=0.0), SimulatedClock(-3 * MS, -9.0), LAN),
    ]
    rig = ready_rig(specs, seed=5)
    rig.trigger(frames=3)
    rig.run_for(3_000 * MS)
    return rig


@pytest.mark.parametrize("bias_ns", [0, 15 * MS, 30 * MS])
def test_a_bias_that_nobody_knows_is_inside_the_error_bar(bias_ns: int) -> None:
    rig = shot(bias_ns)
    for pick in picks(rig, "late"):
        error_ns = abs(pick.leader_ns - pick.frame.start_true_ns)
        assert error_ns <= pick.uncertainty_ns
        assert 10 * MS < pick.uncertainty_ns < 60 * MS
        assert pick.hard_bound_ns is None
    # The other camera is as sure of its times as ever.
    for pick in picks(rig, "true"):
        assert pick.uncertainty_ns < MS
        assert pick.hard_bound_ns is not None


def test_stamps_that_are_right_by_construction_cost_nothing() -> None:
    for pick in picks(shot(None), "late"):
        assert abs(pick.leader_ns - pick.frame.start_true_ns) <= pick.uncertainty_ns < MS
        assert pick.hard_bound_ns is not None
