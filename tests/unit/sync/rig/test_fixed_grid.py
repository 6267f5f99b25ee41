"""A grid whose phase is given, for phones that know no other: no camera moves it."""

import random

from msgspec.structs import replace

from capture_app.common.camera_facts import PhaseControl
from capture_app.common.node_state import NodeState
from capture_app.companions.interop.app_protocol import GOAL_PHASE_NS, PERIOD_NS
from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.rig.rig_config import RequestedConfig
from capture_app.sync.wire.codec import decode, encode
from capture_app.sync.wire.datagrams import Heartbeat, Hello, Report, Welcome
from tests.facts import make_facts

S = 1_000_000_000
WEBCAM = replace(make_facts(), phase_control=PhaseControl.RESET, period_ns=33_333_333)


def leader_with_a_webcam(grid_phase_ns: int | None) -> Leader:
    """Its frames are far from the grid, and it can only be restarted."""
    config = LeaderConfig(1, 0, RequestedConfig(period_ns=PERIOD_NS, grid_phase_ns=grid_phase_ns))
    leader = Leader(config, random.Random(1))
    now_ns = 1000 * S + 7
    leader.receive_datagram(encode(Hello("cam", 5, WEBCAM)), ("10.0.0.2", 1), now_ns)
    ((data, _),) = leader.datagrams_to_send(now_ns)
    welcome = decode(data)
    assert isinstance(welcome, Welcome)
    for step in range(100):
        now_ns = 1001 * S + step * S // 10
        # Ten milliseconds after the app's phase, wherever the grid is.
        frame_ns = now_ns - (now_ns - GOAL_PHASE_NS - 10_000_000) % PERIOD_NS
        report = Report(
            state=NodeState.ALIGNING,
            message="",
            frame_leader_ns=frame_ns,
            drift_ppm=0.0,
            tolerance_ns=2_000_000,
        )
        leader.receive_datagram(encode(Heartbeat(welcome.client, report)), ("10.0.0.2", 1), now_ns)
        leader.handle_timer(now_ns)
    return leader


def test_a_given_phase_stays_whatever_cameras_can() -> None:
    grid = leader_with_a_webcam(GOAL_PHASE_NS).grid
    assert grid is not None
    assert grid.period_ns == PERIOD_NS
    assert grid.anchor_leader_ns % PERIOD_NS == GOAL_PHASE_NS


def test_otherwise_the_grid_goes_to_the_camera_that_cannot_move() -> None:
    grid = leader_with_a_webcam(None).grid
    assert grid is not None
    phase_ns = (grid.anchor_leader_ns - GOAL_PHASE_NS) % PERIOD_NS
    assert abs(phase_ns - 10_000_000) <= 2_000_000
