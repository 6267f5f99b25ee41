"""A grid that one camera's contradicting reports do not move, be it a liar or a webcam with a bad clock."""

import random
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from functools import cache

import pytest
from msgspec import structs

from benchmarks.simulated.virtual_rig import NodeSpec, VirtualNode, VirtualRig
from capture_app.common.camera_facts import PhaseControl
from capture_app.common.clock import SimulatedClock
from capture_app.common.node_state import NodeState
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.sync.wire.codec import decode, encode
from capture_app.sync.wire.datagrams import Heartbeat, Hello, Report
from tests.sync.rig.rigs import LAN, MS, S

PERIOD_NS = 33_333_333
HONEST = ("cam1", "cam2")


class RigWithALiar(VirtualRig):
    """A rig in which the reports of the node `liar` are changed on their way to the leader."""

    lie: Callable[[Report], Report] | None = None
    control = PhaseControl.NONE

    def _to_leader(self, data: bytes, node: VirtualNode) -> None:
        if node.spec.name == "liar":
            message = decode(data)
            if isinstance(message, Hello):
                camera = structs.replace(message.camera, phase_control=self.control)
                data = encode(structs.replace(message, camera=camera))
            if isinstance(message, Heartbeat) and self.lie is not None:
                data = encode(Heartbeat(message.client, self.lie(message.report)))
        super()._to_leader(data, node)

    def looks(self, count: int, every_ns: int = S) -> list[bool]:
        """Whether the honest cameras are ready, at each of so many looks."""
        found = []
        for _ in range(count):
            self.run_for(every_ns)
            members = self.leader.roster.members
            found.append(all(members[name].report.state is NodeState.READY for name in HONEST))
        return found


def rig_with_a_liar(control: PhaseControl) -> RigWithALiar:
    profile = replace(PROFILES["phone-a"], row_time_ns=10_000, frame_length_rows=3333)
    specs = [
        NodeSpec(name, profile, SimulatedClock(7 * number * S, 5.0 * number), LAN, tolerance_ns=MS)
        for number, name in enumerate((*HONEST, "liar"))
    ]
    rig = RigWithALiar(specs, seed=3)
    rig.control = control
    return rig


def ready_rig_with_a_liar(control: PhaseControl) -> RigWithALiar:
    return deepcopy(run_until_ready(control))


@cache
def run_until_ready(control: PhaseControl) -> RigWithALiar:
    """The same one for all tests, which copy it."""
    rig = rig_with_a_liar(control)
    assert rig.run_until(rig.all_ready, limit_ns=60 * S)
    return rig


@pytest.mark.parametrize("control", [PhaseControl.NONE, PhaseControl.RESET])
def test_another_phase_in_each_report_leaves_the_others_ready(control: PhaseControl) -> None:
    rig, rng = ready_rig_with_a_liar(control), random.Random(5)

    def another_phase(report: Report) -> Report:
        at_ns = rig.now_true_ns + rng.randrange(PERIOD_NS)
        return structs.replace(
            report, state=NodeState.READY, frame_leader_ns=at_ns, tolerance_ns=MS, drift_ppm=0.0
        )

    rig.lie = another_phase
    assert sum(rig.looks(8)) == 8


def test_small_steps_of_a_phase_move_the_grid_rarely() -> None:
    rig, sent = ready_rig_with_a_liar(PhaseControl.NONE), 0

    def step_further(report: Report) -> Report:
        nonlocal sent
        sent += 1
        at_ns = rig.now_true_ns // PERIOD_NS * PERIOD_NS + sent * 17 * MS // 10
        return structs.replace(
            report, state=NodeState.READY, frame_leader_ns=at_ns, tolerance_ns=MS, drift_ppm=0.0
        )

    rig.lie = step_further
    assert sum(rig.looks(12)) >= 11


def test_a_webcam_with_a_bad_clock_is_named_and_moves_nobody() -> None:
    """Its timestamps come late by up to a third of a period, each time its report is made anew."""
    rig, rng = rig_with_a_liar(PhaseControl.NONE), random.Random(8)

    def late(report: Report) -> Report:
        at_ns = report.frame_leader_ns
        return structs.replace(report, frame_leader_ns=at_ns and at_ns + rng.randrange(10 * MS))

    rig.lie = late
    rig.run_for(10 * S)
    assert sum(rig.looks(8)) == 8
    report = rig.leader.roster.members["liar"].report
    assert report.state is NodeState.DEGRADED
    assert "its frame times jumped by" in report.message
    assert "check its clock" in report.message


def test_a_camera_that_cannot_move_and_says_the_truth_has_the_grid_moved_to_it() -> None:
    rig = ready_rig_with_a_liar(PhaseControl.NONE)
    assert rig.leader.grid is not None
    at_ns = rig.leader.roster.members["liar"].report.frame_leader_ns
    assert at_ns is not None
    assert abs(rig.leader.grid.phase_error(at_ns)) <= 2 * MS
