"""Nodes are ready by how well they know the time, and say what keeps them from it."""

import re
from dataclasses import replace

from benchmarks.simulated.virtual_rig import VirtualRig
from capture_app.common.node_state import NodeState
from capture_app.plugins.cameras.sim.profiles import PROFILES
from tests.unit.sync.rig.rigs import LAN, S
from tests.unit.sync.rig.test_ready_by_quality import in_state, report, spec


def test_a_clock_coarser_than_the_tolerance_stays_the_reason_while_frames_are_moved() -> None:
    rig = VirtualRig([replace(spec("fine", LAN, 1_000), profile=PROFILES["phone-a"])], seed=5)
    aligning = lambda: in_state(rig, "fine", NodeState.ALIGNING)  # noqa: E731
    assert rig.run_until(aligning, limit_ns=40 * S)
    states, reasons = set(), set()
    for _ in range(100):
        rig.run_for(S // 5)
        told = report(rig, "fine")
        states.add(told.state)
        reasons.add(re.sub(r"error ≤ [\d.]+ [µm]s|-us \d+", "", told.message))
    assert NodeState.ALIGNING in states
    assert len(reasons) == 1
    assert "target 1.0 µs" in reasons.pop()
