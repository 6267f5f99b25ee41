"""Picks of cameras whose timestamps come in coarse steps, judged by the simulated sensors' true times."""

import random
from dataclasses import replace
from typing import Any

import pytest

from benchmarks.simulated.virtual_rig import NodeSpec, VirtualRig
from capture_app.common.clock import SimulatedClock
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.plugins.cameras.sim.sensor import SensorFrame
from capture_app.sync.rig.frame_selection import SelectedFrame
from tests.unit.sync.rig.rigs import LAN, MS, S

BURSTS = 3
FRAMES = 100
ROWS_OF_40_MS = {"row_time_ns": 10_000, "frame_length_rows": 4000}
"""A period that is a multiple of the step: all frames hide the same."""


def coarse_node(name: str, model: str, *, cut: bool, **changes: Any) -> NodeSpec:
    rng = random.Random(f"{name} {cut}")
    profile = replace(PROFILES[model], timestamp_quantum_ns=MS, timestamps_cut=cut, **changes)
    clock = SimulatedClock(rng.randrange(-S, S), rng.uniform(-30, 30))
    return NodeSpec(name, profile, clock, LAN, tolerance_ns=2 * MS)


def picks_of(rig: VirtualRig) -> list[SelectedFrame[SensorFrame]]:
    found: list[SelectedFrame[SensorFrame]] = []
    for _ in range(BURSTS):
        burst = rig.trigger(frames=FRAMES)
        rig.run_for(5 * S)
        found += [pick for node in rig.nodes.values() for pick in node.bursts[burst.number].frames]
        rig.run_for(2 * S)
    return found


@pytest.mark.parametrize("cut", [True, False], ids=["cut", "rounded"])
@pytest.mark.parametrize("period", ["33 ms", "40 ms"])
def test_a_pick_says_what_stamps_of_1_ms_hide(cut: bool, period: str) -> None:
    if period == "33 ms":
        specs = [coarse_node(model, model, cut=cut) for model in ("phone-a", "phone-b", "pi")]
    else:
        specs = [coarse_node("phone-a", "phone-a", cut=cut, **ROWS_OF_40_MS)]
    rig = VirtualRig(specs, seed=4)
    assert rig.run_until(rig.all_ready, limit_ns=60 * S)
    picks = picks_of(rig)
    assert len(picks) > 0.9 * len(specs) * BURSTS * FRAMES
    errors_ns = [abs(pick.stamp_leader_ns - pick.frame.start_true_ns) for pick in picks]
    stated = [error <= pick.uncertainty_ns for error, pick in zip(errors_ns, picks, strict=True)]
    assert sum(stated) >= 0.99 * len(picks)
    assert all(error <= pick.hard_bound_ns for error, pick in zip(errors_ns, picks, strict=True))
    assert all(pick.hard_bound_ns >= pick.uncertainty_ns for pick in picks)
    assert max(pick.uncertainty_ns for pick in picks) < 1.2 * MS, "the step and the clock, and no more"
