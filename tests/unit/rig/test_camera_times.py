"""What pictures tell of the cameras' times becomes what is known of their stamps."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
from msgspec import structs

from benchmarks.simulated.virtual_rig import NodeSpec
from capture_app.common.camera_facts import EXACT_STAMPS, CameraFacts, StampAccuracy, StampSource
from capture_app.common.clock import SimulatedClock
from capture_app.node.camera.device_profiles import DeviceProfiles, camera_key
from capture_app.plugins.cameras.sim.profiles import PROFILES
from capture_app.rig.camera_times import (
    MeasuredTime,
    MeasuredTimes,
    choose_reference,
    measured_asymmetries,
    measured_stamps,
)
from capture_app.session.format.manifest import CameraRecord, ClockRecord
from tests.facts import make_facts
from tests.unit.sync.rig.rigs import LAN, MS, ready_rig

EXACT = make_facts()
WEBCAM = make_facts(kind="v4l2", exposure_ns=10 * MS)
ASSUMED = WEBCAM.stamp_accuracy
REFERENCE = MeasuredTime(offset_ms=0.0, sd_ms=0.0, source="reference")


def record(name: str, facts: CameraFacts, *, uncertainty_ns: int = 0, round_trip_ns: int = 0) -> CameraRecord:
    clock = ClockRecord(
        epoch_local_ns=0,
        offset_ns=0,
        skew_ppm=0.0,
        uncertainty_ns=uncertainty_ns,
        hard_bound_ns=10 * uncertainty_ns,
        round_trip_ns=round_trip_ns,
        samples=300,
    )
    return CameraRecord(name=name, facts=facts, clock=clock)


def stamps(**cameras: tuple[object, MeasuredTime]) -> dict[str, StampAccuracy]:
    records = {name: CameraRecord(name=name, facts=facts) for name, (facts, _) in cameras.items()}  # type: ignore[arg-type]
    times = {name: time for name, (_, time) in cameras.items()}
    reference = next(name for name, time in times.items() if time is REFERENCE)
    return measured_stamps(records, MeasuredTimes(reference=reference, cameras=times))


def test_the_bias_is_what_was_taken_off_less_the_lateness_of_the_light() -> None:
    """Stamps 15 ms late of which 30 ms were taken off: the light seems 15 ms later than told."""
    light = MeasuredTime(offset_ms=ASSUMED.bias_ns / MS - 15, sd_ms=0.1, source="motion")
    found = stamps(true=(EXACT, REFERENCE), late=(WEBCAM, light))
    assert found.keys() == {"late"}, "the other is known by construction"
    assert found["late"].bias_ns == 15 * MS
    assert found["late"].uncertainty_ns == pytest.approx(0.196 * MS, rel=1e-3)
    assert found["late"].source is StampSource.MOTION
    assert found["late"].exposure_ns == 10 * MS
    assert found["late"].against == ""


def test_where_no_camera_knows_its_stamps_they_are_right_against_each_other_only() -> None:
    late = MeasuredTime(offset_ms=-4.0, sd_ms=0.05, source="light")
    found = stamps(a=(WEBCAM, REFERENCE), b=(WEBCAM, late))
    assert found["a"].bias_ns == ASSUMED.bias_ns
    assert found["b"].bias_ns == ASSUMED.bias_ns + 4 * MS
    assert {one.against for one in found.values()} == {"a"}
    assert {one.source for one in found.values()} == {StampSource.LIGHT}
    assert found["a"].uncertainty_ns == 0
    assert {one.against_uncertainty_ns for one in found.values()} == {ASSUMED.uncertainty_ns}
    # Measured again, against one that was measured before: its error is added.
    again = stamps(
        b=(make_facts(kind="v4l2", stamp=found["b"]), REFERENCE),
        c=(WEBCAM, MeasuredTime(offset_ms=1.0, sd_ms=0.05, source="light")),
    )
    assert again["c"].against == "a"
    assert again["c"].against_uncertainty_ns == ASSUMED.uncertainty_ns, "of a's stamps, not of b's"
    assert again["c"].uncertainty_ns == pytest.approx(1.414 * found["b"].uncertainty_ns, rel=0.01)


def test_the_errors_of_both_clocks_are_part_of_a_measured_delays_error() -> None:
    records = {
        "a": record("a", EXACT, uncertainty_ns=30_000),
        "b": record("b", WEBCAM, uncertainty_ns=40_000),
    }
    light = MeasuredTime(offset_ms=1.0, sd_ms=0.05, source="light")
    found = measured_stamps(records, MeasuredTimes(reference="a", cameras={"a": REFERENCE, "b": light}))
    assert found["b"].uncertainty_ns == pytest.approx(math.hypot(98_000, 30_000, 40_000), rel=1e-3)


def test_what_could_not_be_told_or_is_known_better_stays_as_it_was() -> None:
    rough = MeasuredTime(offset_ms=0.3, sd_ms=0.5, source="motion")
    driver = make_facts(
        kind="aravis", stamp=StampAccuracy(bias_ns=0, uncertainty_ns=20_000, source=StampSource.DRIVER)
    )
    unseen = MeasuredTime(reason="nothing moves before it")
    assert stamps(a=(EXACT, REFERENCE), b=(driver, rough), c=(WEBCAM, unseen)) == {}


def test_what_a_driver_knows_is_not_given_up_for_what_is_right_against_an_unknown_only() -> None:
    driver = make_facts(
        kind="aravis", stamp=StampAccuracy(bias_ns=0, uncertainty_ns=MS, source=StampSource.DRIVER)
    )
    fine = MeasuredTime(offset_ms=0.3, sd_ms=0.05, source="light")
    assert stamps(a=(WEBCAM, REFERENCE), b=(driver, fine)).keys() == {"a"}
    assert stamps(a=(EXACT, REFERENCE), b=(driver, fine)).keys() == {"b"}


def test_the_reference_is_the_camera_that_knows_its_stamps_best() -> None:
    driver = make_facts(
        kind="aravis", stamp=StampAccuracy(bias_ns=0, uncertainty_ns=20_000, source=StampSource.DRIVER)
    )
    webcam, known = record("a", WEBCAM), record("b", driver)
    assert choose_reference({"a": webcam, "b": known, "c": record("c", EXACT)}) == "c"
    assert choose_reference({"a": webcam, "b": known}) == "b"
    assert choose_reference({"a": webcam}) is None
    over_wifi = record("d", EXACT, uncertainty_ns=80_000)
    assert choose_reference({"d": over_wifi, "b": record("b", driver, uncertainty_ns=3_000)}) == "b"


def test_where_stamps_are_known_what_is_left_is_of_the_link() -> None:
    """The clock of b, over WiFi, is 150 us behind: its light seems to come so much later than it was told."""
    records = {
        "wire": record("wire", EXACT, uncertainty_ns=5_000, round_trip_ns=80_000),
        "wifi": record("wifi", EXACT, uncertainty_ns=125_000, round_trip_ns=1_200_000),
        "webcam": record("webcam", WEBCAM, uncertainty_ns=90_000, round_trip_ns=1_200_000),
    }
    light = MeasuredTime(offset_ms=0.15, sd_ms=0.01, source="light")
    times = MeasuredTimes(
        reference="wire", cameras={"wire": REFERENCE, "wifi": light, "webcam": light, "gone": light}
    )
    stamps = measured_stamps(records, times)
    assert stamps.keys() == {"webcam"}, "tens of milliseconds that nobody knew"
    ways = measured_asymmetries(records, times, stamps)
    assert ways.keys() == {"wifi"}
    assert (ways["wifi"].late_ns, ways["wifi"].round_trip_ns) == (150_000, 1_200_000)
    # The light and the reference's clock; the node adds its own clock's scatter.
    assert ways["wifi"].uncertainty_ns == pytest.approx((19_600**2 + 5_000**2) ** 0.5, rel=0.01)


def test_what_tells_less_of_a_link_than_is_usual_is_not_kept() -> None:
    records = {
        "a": record("a", EXACT),
        "b": record("b", EXACT, uncertainty_ns=90_000, round_trip_ns=1_200_000),
    }
    motion = MeasuredTime(offset_ms=0.15, sd_ms=0.15, source="motion")
    times = MeasuredTimes(reference="a", cameras={"a": REFERENCE, "b": motion})
    assert measured_asymmetries(records, times, ()) == {}


def test_a_measured_stamp_is_kept_for_this_camera_in_this_mode(tmp_path: Path) -> None:
    measured = StampAccuracy(bias_ns=15 * MS, uncertainty_ns=MS, source=StampSource.MOTION)
    profiles = DeviceProfiles(tmp_path)
    assert profiles.read(camera_key("cam0", WEBCAM)).stamp is None
    assert profiles.save(camera_key("cam0", WEBCAM), stamp=measured)
    again = DeviceProfiles(tmp_path)
    assert again.read(camera_key("cam0", WEBCAM)).stamp == measured
    assert again.read(camera_key("cam1", WEBCAM)).stamp is None
    assert again.read(camera_key("cam0", make_facts(kind="v4l2", exposure_ns=20 * MS))).stamp is None
    assert (
        again.read(camera_key("cam0", make_facts(kind="v4l2", exposure_ns=10 * MS, width=1280))).stamp is None
    )


def test_a_rig_goes_by_a_measured_stamp_at_once() -> None:
    """15 ms late, unknown at first: then within the error bar of what was measured, and aligned by it."""
    late = replace(PROFILES["phone-a"], stamp_bias_ns=15 * MS, drop_fraction=0.0)
    specs = [
        NodeSpec("late", late, SimulatedClock(5 * MS, 8.0), LAN),
        NodeSpec("true", replace(PROFILES["phone-b"], drop_fraction=0.0), SimulatedClock(-3 * MS, -9.0), LAN),
    ]
    rig = ready_rig(specs, seed=5)
    measured = StampAccuracy(bias_ns=15 * MS + 100_000, uncertainty_ns=400_000, source=StampSource.MOTION)
    client = rig.nodes["late"].client
    client.update_camera(structs.replace(client.config.camera, stamp=measured))
    rig.run_for(100 * MS)
    assert rig.run_until(rig.all_ready, limit_ns=60_000 * MS)
    rig.trigger(frames=3)
    rig.run_for(3_000 * MS)
    for pick in next(iter(rig.nodes["late"].bursts.values())).frames:
        assert abs(pick.leader_ns - pick.frame.start_true_ns) <= pick.uncertainty_ns < MS
        assert abs(pick.residual_ns) < MS
    (view,) = (one for one in rig.leader.roster.by_name() if one.name == "late")
    assert view.camera.stamp == measured, "the leader shows it"
    assert EXACT_STAMPS in {one.camera.stamp_accuracy for one in rig.leader.roster.by_name()}
