"""What a frame's stamp says about its rows, wherever in the frame the driver stamps."""

import pytest
from msgspec import structs

from capture_app.common.camera_facts import (
    CameraFacts,
    StampAccuracy,
    StampSource,
    TimestampSource,
    parse_settings,
)
from capture_app.common.errors import BadInputError
from tests.facts import make_facts

MS = 1_000_000
START, END, UNKNOWN = TimestampSource


def facts(source: TimestampSource, row_time_ns: int | None = 10_000) -> CameraFacts:
    return make_facts(height=101, timestamp_source=source, row_time_ns=row_time_ns, exposure_ns=4 * MS)


def test_a_row_is_exposed_from_its_start_on_or_until_it_is_read() -> None:
    """The last of 101 rows starts 1 ms after the first; a stamp at the end of the frame is its end."""
    assert [facts(START).mid_exposure_offset_ns(row) for row in (0.0, 0.5, 1.0)] == [2 * MS, 2.5 * MS, 3 * MS]
    assert [facts(END).mid_exposure_offset_ns(row) for row in (0.0, 0.5, 1.0)] == [
        -3 * MS,
        -2.5 * MS,
        -2 * MS,
    ]


@pytest.mark.parametrize("unknown", [facts(UNKNOWN), facts(START, None), facts(END, None)])
def test_what_is_not_known_is_not_guessed(unknown: CameraFacts) -> None:
    assert unknown.mid_exposure_offset_ns(0.5) is None


def test_what_is_known_of_the_stamps_is_taken_off() -> None:
    """Late by 3 ms: the exposure begins earlier, and so do its middle and the moment that is aligned."""
    late = StampAccuracy(bias_ns=3 * MS, uncertainty_ns=MS, source=StampSource.MOTION)
    camera = structs.replace(facts(START), kind="v4l2", stamp=late)
    assert camera.exposure_start_ns(10 * MS, 4 * MS) == 7 * MS
    assert camera.start_offset_ns() == -3 * MS
    assert camera.mid_exposure_offset_ns(0.0) == -1 * MS
    of_the_end = structs.replace(camera, timestamp_source=END)
    assert of_the_end.exposure_start_ns(10 * MS, 4 * MS) == 10 * MS - 4 * MS - 1 * MS - 3 * MS


def test_a_measured_bias_tells_the_light_of_stamps_of_any_moment() -> None:
    late = StampAccuracy(bias_ns=30 * MS, uncertainty_ns=MS, source=StampSource.LIGHT)
    camera = structs.replace(facts(UNKNOWN), kind="rtsp", stamp=late)
    assert camera.exposure_start_ns(100 * MS, None) == 70 * MS
    assumed = structs.replace(camera, stamp=camera.assumed_stamp)
    assert assumed.exposure_start_ns(100 * MS, None) is None
    assert assumed.start_offset_ns() == -assumed.assumed_stamp.bias_ns


@pytest.mark.parametrize("source", [START, END, UNKNOWN])
@pytest.mark.parametrize("exposure_ns", [None, 100_000, 4 * MS, 33 * MS])
def test_a_real_camera_of_which_nothing_is_said_is_assumed_to_be_off_by_tens_of_ms(
    source: TimestampSource, exposure_ns: int | None
) -> None:
    camera = make_facts(kind="v4l2", timestamp_source=source, exposure_ns=exposure_ns)
    accuracy = camera.stamp_accuracy
    assert accuracy.source is StampSource.ASSUMED
    assert 10 * MS < accuracy.uncertainty_ns < 60 * MS
    # A stamp is not before its light.
    assert accuracy.bias_ns >= accuracy.uncertainty_ns
    assert not accuracy.is_exact


def test_a_simulated_camera_is_what_it_says() -> None:
    assert facts(START).stamp_accuracy.is_exact


def test_controls_are_written_as_name_and_value() -> None:
    assert parse_settings(["exposure=4e3", "gain=auto", "white-balance=hold"]) == {
        "exposure": 4000.0,
        "gain": "auto",
        "white-balance": "hold",
    }
    for text in ("exposure", "exposure=", "gain=inf", "gain=nan", "focus=near"):
        with pytest.raises(BadInputError, match="is not a number, auto or hold"):
            parse_settings([text])
    with pytest.raises(BadInputError, match="with one of exposure, gain, white-balance, focus"):
        parse_settings(["iso=100"])
