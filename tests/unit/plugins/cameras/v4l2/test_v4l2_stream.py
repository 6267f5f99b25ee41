"""The stream's state machine over a device that exists only here."""

import asyncio
import errno
import time
from collections.abc import AsyncIterator

import cv2
import numpy as np
import pytest

from capture_app.cameras.frames import CapturedFrame, JpegPicture, PixelFormat, PixelPicture, raw_picture
from capture_app.common.camera_facts import PhaseControl, TimestampSource
from capture_app.common.errors import CameraError
from capture_app.plugins.cameras.v4l2 import kernel as v4l2
from capture_app.plugins.cameras.v4l2.v4l2_driver import V4L2Camera
from capture_app.sync.wire.camera_commands import InjectFrame, RestartStream
from tests.unit.plugins.cameras.v4l2.fake_device import JPEG, MJPG, PERIOD_NS, FakeDevice
from tests.waiting import until


class Bench:
    """A camera on a device of the test's, and what a node would do with its frames and failures."""

    def __init__(self, device: FakeDevice) -> None:
        self.device = device
        self.camera = V4L2Camera(device, MJPG, PERIOD_NS)
        self.frames: asyncio.Queue[CapturedFrame] = asyncio.Queue()
        self.failures: asyncio.Queue[Exception] = asyncio.Queue()

    async def frame(self) -> CapturedFrame:
        return await asyncio.wait_for(self.frames.get(), 30)

    async def failure(self) -> Exception:
        return await asyncio.wait_for(self.failures.get(), 30)


async def started(device: FakeDevice) -> Bench:
    bench = Bench(device)
    await bench.camera.start(bench.frames.put_nowait, bench.failures.put_nowait)
    return bench


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    """A camera that streams; stopped in the end, where the test has not done so."""
    bench = await started(FakeDevice())
    yield bench
    await bench.camera.stop()


async def test_frames_carry_the_drivers_stamp_number_and_bytes(bench: Bench) -> None:
    stamps = [bench.device.deliver(sequence) for sequence in (0, 1)]
    frames = [await bench.frame(), await bench.frame()]
    assert [frame.timestamp_ns for frame in frames] == stamps
    assert [(frame.stream, frame.sequence) for frame in frames] == [(1, 0), (1, 1)]
    assert frames[0].picture.encode() == JPEG
    assert (frames[0].exposure_ns, frames[0].gain) == (15_700_000, 4.0)


@pytest.mark.parametrize(("driver", "source"), [("uvcvideo", "profile"), ("cafe_ccic", "assumed")])
async def test_no_driver_is_believed_what_its_stamps_are(driver: str, source: str) -> None:
    """The exposure of 15.7 ms, a frame and 5 ms may lie between the light and the arrival of its bytes."""
    bench = await started(FakeDevice(driver=driver))
    stamp = bench.camera.facts.stamp_accuracy
    assert stamp.source == source
    assert stamp.bias_ns == stamp.uncertainty_ns == (15_700_000 + PERIOD_NS + 5_000_000) // 2
    await bench.camera.stop()


async def test_info_says_what_the_device_can_do(bench: Bench) -> None:
    facts = bench.camera.facts
    assert (facts.kind, facts.model, facts.pixel_format) == ("v4l2", "Fake camera", "MJPG")
    assert facts.timestamp_source is TimestampSource.START_OF_EXPOSURE
    assert facts.phase_control is PhaseControl.RESET
    exposures_ns = facts.min_exposure_ns, facts.exposure_ns, facts.max_exposure_ns
    assert exposures_ns == (100_000, 15_700_000, 500_000_000)


@pytest.mark.parametrize(
    ("frame_bytes", "period_ns", "count"),
    [(614_400, PERIOD_NS, 16), (16_588_800, PERIOD_NS, 8), (153_600, 4_000_000, 32), (614_400, 10**9, 4)],
)
def test_half_a_second_is_buffered_where_memory_allows(frame_bytes: int, period_ns: int, count: int) -> None:
    device = FakeDevice()
    V4L2Camera(device, PixelFormat("MJPG", 640, 480, 0, frame_bytes), period_ns)
    assert device.asked_buffers == count


async def test_stamps_at_the_end_of_a_frame_are_called_so() -> None:
    bench = await started(FakeDevice(v4l2.BUF_FLAG_TIMESTAMP_MONOTONIC))
    assert bench.camera.facts.timestamp_source is TimestampSource.END_OF_FRAME
    await bench.camera.stop()


def test_stamps_of_an_unknown_clock_are_refused() -> None:
    with pytest.raises(CameraError, match="monotonic clock"):
        V4L2Camera(FakeDevice(flags=0), MJPG, PERIOD_NS)


async def test_stamps_of_another_clock_fail_the_camera_whatever_the_flags_say(bench: Bench) -> None:
    bench.device.deliver(0, age_ns=3_600_000_000_000)
    assert "monotonic clock" in str(await bench.failure())
    assert bench.frames.empty()


async def test_damaged_frames_are_gaps_and_their_buffers_go_back(bench: Bench) -> None:
    bench.device.deliver(0)
    bench.device.deliver(1, flags=v4l2.BUF_FLAG_ERROR)
    bench.device.deliver(2, data=b"not a JPEG")
    assert (await bench.frame()).sequence == 0
    await until(lambda: len(bench.device.queued) == 3)
    bench.device.deliver(3, data=JPEG[:-2])
    bench.device.deliver(4, data=JPEG + bytes(100))
    assert (await bench.frame()).sequence == 4, "some cameras fill up their buffers"


async def test_automatic_exposure_is_not_claimed_to_be_known() -> None:
    device = FakeDevice()
    device.controls["EXPOSURE_AUTO"] = 3
    bench = await started(device)
    device.deliver(0)
    frame = await bench.frame()
    assert (frame.exposure_ns, frame.gain) == (None, None)
    await bench.camera.stop()


async def test_a_restart_begins_a_new_stream_without_frames_of_the_old(bench: Bench) -> None:
    bench.device.deliver(0)
    assert (await bench.frame()).stream == 1
    bench.device.deliver(1)
    restart = asyncio.ensure_future(bench.camera.apply(RestartStream(0)))
    asked_ns = time.monotonic_ns()
    await restart
    while not bench.frames.empty():
        assert bench.frames.get_nowait().stream == 1
    bench.device.deliver(0)
    frame = await bench.frame()
    assert (frame.stream, frame.sequence) == (2, 0)
    assert bench.device.calls == ["on", "off", "on"]
    # Late by the time of stopping: the start waits for its place in the next period.
    assert bench.device.on_times_ns[1] - asked_ns >= PERIOD_NS - 1_000_000


async def test_the_loop_runs_on_while_the_device_starts(bench: Bench) -> None:
    bench.device.may_start.clear()
    restart = asyncio.ensure_future(bench.camera.apply(RestartStream(0)))
    await until(lambda: "off" in bench.device.calls)
    assert not restart.done()
    bench.device.may_start.set()
    await restart


async def test_stopping_while_it_starts_lets_go_of_the_device_afterwards() -> None:
    device = FakeDevice()
    camera = V4L2Camera(device, MJPG, PERIOD_NS)
    starting = asyncio.create_task(camera.start(lambda frame: None, lambda error: None))
    await asyncio.sleep(0)
    await camera.stop()
    await starting
    assert device.calls.index("on") < device.calls.index("off")


async def test_stopping_cuts_a_restart_short(bench: Bench) -> None:
    restart = asyncio.ensure_future(bench.camera.apply(RestartStream(3_600_000_000_000)))
    await until(lambda: "off" in bench.device.calls)
    await bench.camera.stop()
    await restart
    await bench.camera.stop()
    assert bench.device.calls == ["on", "off", "off", "close"]
    assert bench.failures.empty()


@pytest.mark.parametrize("code", [errno.ENODEV, errno.EIO])
async def test_unplugging_is_reported_once(bench: Bench, code: int) -> None:
    bench.device.unplug(code)
    failure = await bench.failure()
    assert isinstance(failure, CameraError)
    assert "does not answer" in str(failure)
    with pytest.raises(CameraError, match="does not stream"):
        await bench.camera.apply(RestartStream(0))
    await bench.camera.stop()
    await bench.camera.stop()
    assert bench.failures.empty()
    assert bench.device.calls.count("close") == 1


async def test_unplugging_during_a_restart_is_reported_once(bench: Bench) -> None:
    bench.device.stream_on_error = errno.ENODEV
    await bench.camera.apply(RestartStream(0))
    assert isinstance(await bench.failure(), CameraError)
    await bench.camera.stop()
    assert bench.failures.empty()


@pytest.mark.parametrize(("code", "words"), [(errno.ENOSPC, "USB"), (errno.EBUSY, "in use")])
async def test_a_device_that_cannot_start_says_why(code: int, words: str) -> None:
    device = FakeDevice()
    device.stream_on_error = code
    with pytest.raises(CameraError, match=words):
        await started(device)


async def test_a_longer_frame_is_refused(bench: Bench) -> None:
    with pytest.raises(CameraError, match="restart"):
        await bench.camera.apply(InjectFrame(40_000_000))


async def test_the_rate_is_held_in_the_dark_and_the_setting_given_back() -> None:
    device = FakeDevice()
    device.controls["EXPOSURE_AUTO_PRIORITY"] = 1
    bench = await started(device)
    assert device.controls["EXPOSURE_AUTO_PRIORITY"] == 0
    await bench.camera.stop()
    assert device.controls["EXPOSURE_AUTO_PRIORITY"] == 1


def test_raw_frames_become_jpegs_without_the_padding_of_their_lines() -> None:
    red = np.array([[76, 85, 76, 255] * 8] * 16, np.uint8)
    padded = np.pad(red, ((0, 0), (0, 6)), constant_values=200)
    picture = decoded(raw_picture(padded.tobytes(), PixelFormat("YUYV", 16, 16, 38)))
    assert picture.shape == (16, 16, 3)
    assert np.abs(picture.astype(int) - [0, 0, 255]).max() < 12

    grey = np.tile(np.arange(0, 64, 4, dtype=np.uint8), (16, 1))
    picture = decoded(raw_picture(grey.tobytes(), PixelFormat("GREY", 16, 16, 16)))
    assert np.abs(picture.astype(int) - grey).max() < 8

    nv12 = np.concatenate([np.full((16, 16), 76), np.tile([85, 255], (8, 8))]).astype(np.uint8)
    picture = decoded(raw_picture(nv12.tobytes(), PixelFormat("NV12", 16, 16, 16)))
    assert np.abs(picture.astype(int) - [0, 0, 255]).max() < 12


def test_a_preview_of_a_large_picture_is_decoded_small() -> None:
    large = np.zeros((480, 640, 3), np.uint8)
    large[:, 320:] = (0, 0, 255)
    jpeg = bytes(cv2.imencode(".jpg", large)[1])
    for width, shape in ((80, (60, 80, 3)), (100, (120, 160, 3)), (320, (240, 320, 3)), (900, (480, 640, 3))):
        picture = JpegPicture(jpeg).reduced(width)
        assert picture.shape == shape
        assert np.abs(picture[:, -8:].astype(int) - [0, 0, 255]).max() < 12
        assert picture[:, :8].max() < 12
    with pytest.raises(ValueError, match="cannot be decoded"):
        JpegPicture(b"\xff\xd8 nothing").reduced(80)


@pytest.mark.parametrize(
    ("fourcc", "plane", "colour"),
    [
        ("YUYV", np.array([[76, 85, 76, 255] * 8] * 16, np.uint8), (0, 0, 255)),
        ("GREY", np.full((16, 16), 90, np.uint8), (90, 90, 90)),
        (
            "NV12",
            np.concatenate([np.full((16, 16), 76), np.tile([85, 255], (8, 8))]).astype(np.uint8),
            (0, 0, 255),
        ),
    ],
)
def test_a_preview_of_a_raw_picture_leaves_pixels_out(
    fourcc: str, plane: np.ndarray, colour: tuple[int, int, int]
) -> None:
    picture = raw_picture(plane.tobytes(), PixelFormat(fourcc, 16, 16, plane.shape[1])).reduced(8)
    assert picture.shape == (8, 8, 3)
    assert np.abs(picture.astype(int) - colour).max() < 12


def decoded(picture: PixelPicture) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(picture.encode(), np.uint8), cv2.IMREAD_UNCHANGED)
