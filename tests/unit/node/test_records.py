"""The record of a node's camera and clock in a manifest."""

from capture_app.node.camera.camera_node import camera_record
from capture_app.session.format.manifest import CameraRecord, ClockRecord
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.rig.frame_selection import FramesSelected
from capture_app.sync.wire.datagrams import Trigger
from tests.facts import make_facts

OWN = TimeMap(
    epoch_local_ns=5,
    offset_ns=1000,
    skew=0.0,
    uncertainty_ns=40_000.0,
    hard_bound_ns=500_000.0,
    skew_uncertainty=0.0,
    skew_bound=0.0,
    samples=300,
    round_trip_ns=1_000_000,
)


def record_of(time_map: TimeMap) -> CameraRecord:
    ready: FramesSelected[object] = FramesSelected(Trigger(0, 1, 1, 0, 1, 1), (), (), time_map, None)
    return camera_record("cam", make_facts(), ready, 0, 1000)


def clock_of(time_map: TimeMap) -> ClockRecord | None:
    return record_of(time_map).clock


def test_a_clock_is_recorded() -> None:
    clock = clock_of(OWN)
    assert clock is not None
    assert clock.offset_ns == 1000
