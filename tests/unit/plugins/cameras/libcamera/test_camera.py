"""The driver of libcamera's cameras, on a double of the library's module in stepped time."""

import asyncio
from itertools import pairwise
from statistics import median
from typing import Any

import pytest

from capture_app.cameras.frames import CapturedFrame
from capture_app.common.camera_facts import MICROSECONDS, Control, PhaseControl, StampSource
from capture_app.common.errors import BadInputError, CameraError, NotAvailableError
from capture_app.plugins.cameras.libcamera.configuration import parse_options
from capture_app.plugins.cameras.libcamera.libcamera_driver import listings
from capture_app.plugins.cameras.libcamera.libcamera_stream import Library, StampClock
from capture_app.sync.wire.camera_commands import InjectFrame, RestartStream, SetFrameDuration
from tests.unit.plugins.cameras.libcamera.double import libcamera_double
from tests.unit.plugins.cameras.libcamera.double_camera import IDS, Sensor
from tests.unit.plugins.cameras.libcamera.rig import open_double
from tests.unit.plugins.cameras.sim.simulation_driver.stepped import in_stepped_time, true_now_ns

ROW_NS = 18_904
PI = Sensor()


class Opened:
    """One camera of the double, and what it delivered."""

    def __init__(self, sensor: Sensor = PI, **wishes: Any) -> None:
        self.library = Library(libcamera_double(sensor))
        self.double = self.library.cameras[0]
        self.camera = open_double(self.library, 0, **wishes)
        self.frames: list[CapturedFrame] = []
        self.failures: list[Exception] = []

    async def start(self, seconds: float = 0.0) -> None:
        await self.camera.start(self.frames.append, self.failures.append)
        await asyncio.sleep(seconds)

    def intervals_rows(self) -> list[float]:
        stamps = [frame.timestamp_ns for frame in self.frames]
        return [(b - a) / self.double.sensor.row_ns for a, b in pairwise(stamps)]


@in_stepped_time
async def test_the_first_frames_show_rows_and_exposure_and_go_to_nobody() -> None:
    opened = Opened()
    await opened.start()
    began_ns = true_now_ns()
    facts = opened.camera.facts
    assert facts.phase_control is PhaseControl.FRAME_DURATION
    assert facts.row_time_ns == ROW_NS
    assert facts.period_ns == 1763 * ROW_NS
    assert abs(facts.period_ns - 33_333_333) < ROW_NS / 2
    assert (facts.model, facts.width, facts.height, facts.pixel_format) == ("imx219", 64, 48, "NV12")
    await asyncio.sleep(1.0)
    await opened.camera.stop()
    assert 25 <= len(opened.frames) <= 31
    assert opened.frames[0].timestamp_ns > began_ns - 100_000_000
    assert all(abs(rows - 1763) < 0.5 for rows in opened.intervals_rows())
    assert opened.double.lost == 0
    assert not opened.failures


@in_stepped_time
async def test_the_exposure_that_was_found_is_held_and_the_stamps_are_late_by_it() -> None:
    opened = Opened(Sensor(exposure_us=8_000))
    await opened.start(0.5)
    await opened.camera.stop()
    facts, stamp = opened.camera.facts, opened.camera.facts.stamp
    assert facts.exposure_ns is not None
    assert stamp is not None
    assert abs(facts.exposure_ns - 8_000_000) < 0.05 * 8_000_000
    assert {frame.exposure_ns for frame in opened.frames} == {facts.exposure_ns // 1000 * 1000}
    assert (opened.frames[0].gain, opened.frames[0].white_balance) == (2.0, (1.5, 1.25))
    assert stamp.source is StampSource.PROFILE
    assert stamp.uncertainty_ns > 300_000
    errors_ns = [
        facts.exposure_start_ns(frame.timestamp_ns, frame.exposure_ns) - truth.exposed_from_ns
        for frame in opened.frames
        for truth in opened.double.frames
        if truth.sequence == frame.sequence
    ]
    assert len(errors_ns) == len(opened.frames)
    assert abs(median(errors_ns)) < 2_000


@in_stepped_time
async def test_exposure_and_gain_that_were_asked_for_are_set_from_the_start() -> None:
    opened = Opened(exposure_us=3_000, gain=1.5, fps=20.0)
    await opened.start()
    await opened.camera.stop()
    assert opened.camera.facts.exposure_ns == 158 * ROW_NS
    assert abs(opened.camera.facts.period_ns - 50_000_000) < ROW_NS
    assert opened.double._settings[IDS["AnalogueGain"]] == 1.5
    assert opened.double._settings[IDS["AeEnable"]] is False


@in_stepped_time
async def test_exposure_and_gain_are_told_set_and_given_back_to_the_camera() -> None:
    opened = Opened()
    await opened.start(0.1)
    exposure, gain = await opened.camera.controls()
    assert (exposure.control, exposure.unit, exposure.automatic) == (Control.EXPOSURE, MICROSECONDS, False)
    assert (exposure.minimum, exposure.can_be_automatic) == (29, True)
    assert exposure.maximum == pytest.approx(33_333, abs=20), "no exposure makes a frame longer"
    assert (gain.control, gain.value, gain.maximum) == (Control.GAIN, 2.0, 10.7)
    await opened.camera.set_control(Control.EXPOSURE, 2_000.0)
    assert opened.camera.facts.exposure_ns == 105 * ROW_NS
    assert opened.camera.facts.stamp.bias_ns == 105 * ROW_NS
    await asyncio.sleep(0.5)
    assert opened.frames[-1].exposure_ns == 105 * ROW_NS // 1000 * 1000
    assert opened.frames[-1].gain == 2.0, "its gain stays where it was"
    await opened.camera.set_control(Control.EXPOSURE, None)
    assert opened.camera.facts.exposure_ns is None
    assert opened.camera.facts.stamp_accuracy.source is StampSource.ASSUMED
    await asyncio.sleep(0.5)
    assert opened.frames[-1].exposure_ns > 8_000_000
    assert (await opened.camera.controls())[0].automatic
    await opened.camera.stop()


@in_stepped_time
async def test_cameras_are_listed_by_their_ids() -> None:
    library = Library(libcamera_double(PI))
    (listed,) = listings(library)
    assert listed.spec == f"libcamera:{library.cameras[0].id}"
    assert (listed.model, listed.usable) == ("imx219", True)
    assert listed.detail == "sensor of 3280x2464, moved by frame durations"


@in_stepped_time
async def test_one_frame_lasts_as_long_as_it_is_told_to() -> None:
    opened = Opened()
    await opened.start(0.2)
    for rows in (1764, 1700, 2200):
        await opened.camera.apply(SetFrameDuration(round((rows + 0.25) * ROW_NS)))
        await asyncio.sleep(1.0)
    await opened.camera.stop()
    unusual = [round(rows) for rows in opened.intervals_rows() if round(rows) != 1763]
    assert unusual == [1764, 1700, 2200]


@in_stepped_time
async def test_what_comes_back_rounded_tells_the_rows_as_well() -> None:
    opened = Opened(Sensor(row_ns=29_573.1, rounds=True))
    await opened.start()
    await opened.camera.stop()
    assert opened.camera.facts.row_time_ns == 29_573


@in_stepped_time
async def test_a_restart_keeps_to_its_moment_and_to_what_was_learnt() -> None:
    opened = Opened()
    await opened.start(0.3)
    facts, before = opened.camera.facts, len(opened.frames)
    await opened.camera.apply(RestartStream(0))
    await asyncio.sleep(1.0)
    await opened.camera.stop()
    again = opened.frames[before:]
    assert {frame.stream for frame in again} == {opened.frames[0].stream + 1}
    assert again[0].sequence == 0
    assert again[-1].exposure_ns == opened.frames[0].exposure_ns
    assert opened.camera.facts == facts
    assert opened.double.starts == 2


@in_stepped_time
async def test_a_camera_that_falls_silent_has_failed() -> None:
    opened = Opened()
    await opened.start(0.2)
    opened.double.dead = True
    await asyncio.sleep(10.0)
    (error,) = opened.failures
    assert isinstance(error, CameraError)
    assert "delivers no frames any more" in str(error)
    await opened.camera.stop()
    assert not opened.double.acquired
    await opened.camera.stop()


@in_stepped_time
async def test_a_camera_without_a_first_frame_is_an_error_of_the_start() -> None:
    opened = Opened()
    opened.double.dead = True
    with pytest.raises(CameraError, match="delivers no frames"):
        await opened.start()
    await opened.camera.stop()
    assert not opened.failures


@in_stepped_time
async def test_a_camera_in_use_and_one_that_is_not_there_are_said() -> None:
    opened = Opened()
    with pytest.raises(CameraError, match="in use"):
        open_double(opened.library, 0)
    with pytest.raises(CameraError, match="knows no camera 7") as caught:
        open_double(opened.library, 7)
    assert opened.double.id in caught.value.hint
    await opened.camera.stop()
    await open_double(opened.library, 0).stop()


@in_stepped_time
async def test_modes_that_it_does_not_have_are_refused_with_what_it_has() -> None:
    library = Library(libcamera_double(PI))
    with pytest.raises(CameraError, match="no mode NV12 640x480") as caught:
        open_double(library, 0, width=640, height=480)
    assert "width=64,height=48" in caught.value.hint
    with pytest.raises(CameraError, match="does not offer MJPG") as caught:
        open_double(library, 0, format="MJPG")
    assert "NV12" in caught.value.hint
    with pytest.raises(CameraError, match="cannot run at 120 frames/s") as caught:
        open_double(library, 0, fps=120.0)
    assert "66.67" in caught.value.hint
    assert not library.cameras[0].acquired


@in_stepped_time
async def test_commands_that_it_cannot_carry_out_are_refused() -> None:
    opened = Opened()
    await opened.start()
    with pytest.raises(CameraError, match="cannot do that"):
        await opened.camera.apply(InjectFrame(40_000_000))
    await opened.camera.stop()
    with pytest.raises(CameraError, match="does not stream"):
        await opened.camera.apply(RestartStream(0))


def test_an_old_library_is_refused_in_words() -> None:
    with pytest.raises(NotAvailableError, match=r"v0\.0\.3 is too old: 0\.4 or newer"):
        Library(libcamera_double(PI, version="v0.0.3"))


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"width": "0"}, "width=0 of a camera of libcamera"),
        ({"fps": "fast"}, "fps=fast of a camera"),
        ({"exposure_us": "0"}, "exposure_us=0"),
        ({"format": "H264"}, "format=H264 cannot be saved"),
    ],
)
def test_options_that_cannot_be_read_are_named(options: dict[str, str], why: str) -> None:
    with pytest.raises(BadInputError, match=why):
        parse_options(options)


def test_options_are_read() -> None:
    wishes = parse_options({"width": "1640", "fps": "29.97", "format": "mjpeg", "exposure_us": "500.4"})
    assert wishes.size == (1640, 1230)
    assert (wishes.period_us, wishes.format, wishes.exposure_us) == (33_367, "MJPG", 500)


@pytest.mark.parametrize(("stamp_ns", "monotonic_ns"), [(999_000, 999_000), (5_000_000_900_000, 900_000)])
def test_stamps_of_either_clock_are_brought_into_the_monotonic_one(stamp_ns: int, monotonic_ns: int) -> None:
    slept_ns = 5_000_000_000_000

    class Slept(StampClock):
        def now_ns(self) -> int:
            return 1_000_000

        def boot_ns(self) -> int:
            return 1_000_040 + slept_ns

    clock = Slept()
    found_ns = clock.monotonic_of(stamp_ns)
    assert found_ns is not None
    assert abs(found_ns - monotonic_ns) <= 40
    assert clock.monotonic_of(2_000_000_000_000) is None
