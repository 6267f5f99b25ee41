"""A grid that one camera's contradicting reports do not move, be it a liar or a webcam with a bad clock."""

import random

import pytest
from msgspec import structs

from capture_app.common.camera_facts import PhaseControl
from capture_app.common.node_state import NodeState
from capture_app.sync.wire.datagrams import Report
from tests.unit.sync.rig.rigs import MS, S
from tests.unit.sync.rig.test_grid_votes import (
    ready_rig_with_a_liar,
    rig_with_a_liar,
)

PERIOD_NS = 33_333_333


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
