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


def record_of(time_map: TimeMap, name: str = "cam", label: str = "") -> CameraRecord:
    ready: FramesSelected[object] = FramesSelected(Trigger(0, 1, 1, 0, 1, 1), (), (), time_map, None)
    return camera_record(name, make_facts(), ready, 0, 1000, label=label)


def clock_of(time_map: TimeMap) -> ClockRecord | None:
    return record_of(time_map).clock


def test_a_camera_is_called_as_its_owner_wrote_unless_that_is_its_name() -> None:
    assert record_of(OWN, "Bohm", "Böhm").label == "Böhm"
    assert record_of(OWN, "Bohm", "Bohm").label == ""


def test_a_clock_is_recorded() -> None:
    clock = clock_of(OWN)
    assert clock is not None
    assert clock.offset_ns == 1000
