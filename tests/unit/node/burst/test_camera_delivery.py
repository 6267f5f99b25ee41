"""A camera's reports of one burst: what a later run of its node adds to the first one's."""

import pytest
from msgspec.structs import replace

from capture_app.common.bounds import CENTURY_NS, MAX_COUNT
from capture_app.node.burst.camera_delivery import CameraDelivery
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import CameraRecord, WidenedTimes
from tests.unit.node.burst.test_untrue_reports import CLOCK
from tests.unit.node.bursts import CAMERA

HOUR_NS = 3_600_000_000_000
BOOTED = replace(CLOCK, epoch_local_ns=20_000_000_000, offset_ns=5 * HOUR_NS)


def widened_by(*clocks: object) -> tuple[WidenedTimes, ...]:
    """Return what a camera's record says after reports with these clock records."""
    plan = CameraPlan(camera=CameraRecord(name="a", facts=CAMERA))
    delivery = CameraDelivery(plan, heard_ns=0)
    for clock in clocks:
        delivery.note_report(replace(plan, camera=replace(plan.camera, clock=clock)), now_ns=1)
    assert delivery.plan.camera.clock == clocks[0], "its images were timed by it"
    return delivery.plan.camera.widened


def test_what_came_fast_gives_no_more_time_than_from_now_on() -> None:
    delivery = CameraDelivery(CameraPlan(camera=CameraRecord(name="a", facts=CAMERA)), heard_ns=0)
    delivery.note_arrivals(10**12, now_ns=5)
    assert delivery.since_ns == 5


def test_a_machine_that_is_started_again_has_another_clock() -> None:
    """Its session was said to be contradictory, as its clock record holds for the images from before."""
    (other,) = widened_by(CLOCK, BOOTED, BOOTED, CLOCK)
    assert other.from_local_ns == other.until_local_ns == 14_000_000_000
    assert other.uncertainty_ns == 5 * HOUR_NS + 1
    assert other.reason == "its node was started again"


@pytest.mark.parametrize("clocks", [(CLOCK, CLOCK), (None, CLOCK), (CLOCK, None)])
def test_one_clock_or_none_is_not_another(clocks: tuple[object, ...]) -> None:
    assert not widened_by(*clocks)


def test_a_clock_far_off_leaves_a_record_that_can_be_read() -> None:
    far = replace(CLOCK, epoch_local_ns=-CENTURY_NS, offset_ns=CENTURY_NS)
    (other,) = widened_by(replace(CLOCK, offset_ns=-CENTURY_NS), far)
    assert (other.from_local_ns, other.hard_bound_ns) == (-CENTURY_NS, MAX_COUNT)
