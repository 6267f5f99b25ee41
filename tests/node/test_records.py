"""A node's facts in the manifest and the event log: what agreement with other nodes did to its clock."""

from dataclasses import replace

import msgspec
import pytest

from capture_app.node.camera.camera_node import camera_record, event_line
from capture_app.session.format.manifest import ClockRecord
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.rig.frame_selection import FramesSelected
from capture_app.sync.timekeeping.clock_events import ReferenceCorrected
from capture_app.sync.wire.messages import Trigger
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


def clock_of(time_map: TimeMap) -> ClockRecord | None:
    ready: FramesSelected[object] = FramesSelected(Trigger(0, 1, 1, 0, 1, 1), (), (), time_map, None)
    return camera_record("cam", make_facts(), ready, 0, 1000).clock


@pytest.mark.parametrize("below_relay", [False, True])
def test_a_clock_that_was_moved_says_so(below_relay: bool) -> None:
    time_map = OWN.corrected_by(-120_000, 30_000.0, 7_499.6)
    if below_relay:
        time_map = time_map.chained_to(replace(OWN, uncertainty_ns=0.0, hard_bound_ns=0.0, offset_ns=0))
    clock = clock_of(time_map)
    assert clock is not None
    corrected = clock.offset_ns, clock.reference_correction_ns, clock.relative_uncertainty_ns
    assert corrected == (-119_000, -120_000, 7500)
    assert clock.hard_bound_ns == pytest.approx(620_000, abs=2)
    assert msgspec.json.decode(msgspec.json.encode(clock), type=ClockRecord) == clock


def test_a_clock_that_was_not_moved_is_told_as_ever() -> None:
    clock = clock_of(OWN)
    assert clock is not None
    assert (clock.reference_correction_ns, clock.relative_uncertainty_ns) == (None, None)
    assert b"moved" not in msgspec.json.encode(clock)


def test_the_event_log_tells_when_clocks_agree_and_when_no_more() -> None:
    assert event_line(ReferenceCorrected(7500)) == {
        "event": "reference-correction-started",
        "relative_uncertainty_ns": 7500,
    }
    assert event_line(ReferenceCorrected(None)) == {"event": "reference-correction-ended"}
