"""The stream's state machine over a device that exists only here."""

import asyncio
import errno
import time
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from capture_app.camera_facts import PhaseControl, TimestampSource
from capture_app.cameras.base import CapturedFrame
from capture_app.cameras.v4l2 import layout as v4l2
from capture_app.cameras.v4l2.pictures import RawPicture
from capture_app.cameras.v4l2.stream import V4L2Camera
from capture_app.errors import CameraError
from capture_app.sync.wire.camera_commands import InjectFrame, RestartStream
from tests.cameras.fake_device import JPEG, MJPG, PERIOD_NS, FakeDevice


class Sink:
    """What a node would do with a camera's frames and failures."""

    def __init__(self) -> None:
        self.frames: asyncio.Queue[CapturedFrame] = asyncio.Queue()
        self.failures: asyncio.Queue[Exception] = asyncio.Queue()

    async def frame(self) -> CapturedFrame:
        return await asyncio.wait_for(self.frames.get(), 30)

    async def failure(self) -> Exception:
        return await asyncio.wait_for(self.failures.get(), 30)


async def until(condition: Callable[[], bool]) -> None:
    """Let the loop and the worker run until a condition on the device holds."""
    while not condition():  # noqa: ASYNC110
        await asyncio.sleep(0.001)


async def started(device: FakeDevice, layout: v4l2.PixelFormat = MJPG) -> tuple[V4L2Camera, Sink]:
    camera, sink = V4L2Camera(device, layout, PERIOD_NS), Sink()
    await camera.start(sink.frames.put_nowait, sink.failures.put_nowait)
    return camera, sink


async def test_frames_carry_the_drivers_stamp_number_and_bytes():
    device = FakeDevice()
    camera, sink = await started(device)
    stamps = [device.deliver(sequence) for sequence in (0, 1)]
    frames = [await sink.frame(), await sink.frame()]
    assert [frame.timestamp_ns for frame in frames] == stamps
    assert [(frame.stream, frame.sequence) for frame in frames] == [(1, 0), (1, 1)]
    assert frames[0].picture.encode() == JPEG
    assert (frames[0].exposure_ns, frames[0].gain) == (15_700_000, 4.0)
    await camera.stop()


async def test_info_says_what_the_device_can_do():
    camera = V4L2Camera(FakeDevice(), MJPG, PERIOD_NS)
    facts = camera.facts
    assert (facts.kind, facts.model, facts.pixel_format) == ("v4l2", "Fake camera", "MJPG")
    assert facts.timestamp_source is TimestampSource.START_OF_EXPOSURE
    assert facts.phase_control is PhaseControl.RESET
    assert (facts.min_exposure_ns, facts.exposure_ns, facts.max_exposure_ns) == (
        100_000,
        15_700_000,
        500_000_000,
    )
    await camera.stop()


@pytest.mark.parametrize(
    ("frame_bytes", "period_ns", "count"),
    [(614_400, PERIOD_NS, 16), (16_588_800, PERIOD_NS, 4), (153_600, 4_000_000, 24), (614_400, 10**9, 4)],
)
def test_half_a_second_is_buffered_where_memory_allows(frame_bytes, period_ns, count):
    device = FakeDevice()
    V4L2Camera(device, v4l2.PixelFormat("MJPG", 640, 480, 0, frame_bytes), period_ns)
    assert device.asked_buffers == count


async def test_stamps_at_the_end_of_a_frame_are_called_so():
    camera = V4L2Camera(FakeDevice(v4l2.BUF_FLAG_TIMESTAMP_MONOTONIC), MJPG, PERIOD_NS)
    assert camera.facts.timestamp_source is TimestampSource.END_OF_FRAME
    await camera.stop()


def test_stamps_of_an_unknown_clock_are_refused():
    with pytest.raises(CameraError, match="monotonic clock"):
        V4L2Camera(FakeDevice(flags=0), MJPG, PERIOD_NS)


async def test_stamps_of_another_clock_fail_the_camera_whatever_the_flags_say():
    device = FakeDevice()
    camera, sink = await started(device)
    device.deliver(0, age_ns=3_600_000_000_000)
    assert "monotonic clock" in str(await sink.failure())
    assert sink.frames.empty()
    await camera.stop()


async def test_damaged_frames_are_gaps_and_their_buffers_go_back():
    device = FakeDevice()
    camera, sink = await started(device)
    device.deliver(0)
    device.deliver(1, flags=v4l2.BUF_FLAG_ERROR)
    device.deliver(2, data=b"not a JPEG")
    assert (await sink.frame()).sequence == 0
    await until(lambda: len(device.queued) == 3)
    device.deliver(3)
    assert (await sink.frame()).sequence == 3
    await camera.stop()


async def test_automatic_exposure_is_not_claimed_to_be_known():
    device = FakeDevice()
    device.controls[v4l2.CID_EXPOSURE_AUTO] = 3
    camera, sink = await started(device)
    device.deliver(0)
    frame = await sink.frame()
    assert (frame.exposure_ns, frame.gain) == (None, None)
    await camera.stop()


async def test_a_restart_begins_a_new_stream_without_frames_of_the_old():
    device = FakeDevice()
    camera, sink = await started(device)
    device.deliver(0)
    assert (await sink.frame()).stream == 1
    device.deliver(1)
    restart = asyncio.ensure_future(camera.apply(RestartStream(0)))
    asked_ns = time.monotonic_ns()
    await restart
    while not sink.frames.empty():
        assert sink.frames.get_nowait().stream == 1
    device.deliver(0)
    frame = await sink.frame()
    assert (frame.stream, frame.sequence) == (2, 0)
    assert device.calls == ["on", "off", "on"]
    # Late by the time of stopping: the start waits for its place in the next period.
    assert device.on_times_ns[1] - asked_ns >= PERIOD_NS - 1_000_000
    await camera.stop()


async def test_the_loop_runs_on_while_the_device_starts():
    device = FakeDevice()
    camera, _sink = await started(device)
    device.may_start.clear()
    restart = asyncio.ensure_future(camera.apply(RestartStream(0)))
    await until(lambda: "off" in device.calls)
    assert not restart.done()
    device.may_start.set()
    await restart
    await camera.stop()


async def test_stopping_cuts_a_restart_short():
    device = FakeDevice()
    camera, sink = await started(device)
    restart = asyncio.ensure_future(camera.apply(RestartStream(3_600_000_000_000)))
    await until(lambda: "off" in device.calls)
    await camera.stop()
    await restart
    await camera.stop()
    assert device.calls == ["on", "off", "off", "close"]
    assert sink.failures.empty()


@pytest.mark.parametrize("code", [errno.ENODEV, errno.EIO])
async def test_unplugging_is_reported_once(code):
    device = FakeDevice()
    camera, sink = await started(device)
    device.unplug(code)
    failure = await sink.failure()
    assert isinstance(failure, CameraError)
    assert "does not answer" in str(failure)
    with pytest.raises(CameraError, match="does not stream"):
        await camera.apply(RestartStream(0))
    await camera.stop()
    await camera.stop()
    assert sink.failures.empty()
    assert device.calls.count("close") == 1


async def test_unplugging_during_a_restart_is_reported_once():
    device = FakeDevice()
    camera, sink = await started(device)
    device.stream_on_error = errno.ENODEV
    await camera.apply(RestartStream(0))
    assert isinstance(await sink.failure(), CameraError)
    await camera.stop()
    assert sink.failures.empty()


@pytest.mark.parametrize(("code", "words"), [(errno.ENOSPC, "USB"), (errno.EBUSY, "in use")])
async def test_a_device_that_cannot_start_says_why(code, words):
    device = FakeDevice()
    device.stream_on_error = code
    with pytest.raises(CameraError, match=words):
        await started(device)


async def test_a_longer_frame_is_refused():
    camera, _sink = await started(FakeDevice())
    with pytest.raises(CameraError, match="restart"):
        await camera.apply(InjectFrame(40_000_000))
    await camera.stop()


async def test_the_rate_is_held_in_the_dark_and_the_setting_given_back():
    device = FakeDevice()
    device.controls[v4l2.CID_EXPOSURE_AUTO_PRIORITY] = 1
    camera, _sink = await started(device)
    assert device.controls[v4l2.CID_EXPOSURE_AUTO_PRIORITY] == 0
    await camera.stop()
    assert device.controls[v4l2.CID_EXPOSURE_AUTO_PRIORITY] == 1


def test_raw_frames_become_jpegs_without_the_padding_of_their_lines():
    red = np.array([[76, 85, 76, 255] * 8] * 16, np.uint8)
    padded = np.pad(red, ((0, 0), (0, 6)), constant_values=200)
    picture = decoded(RawPicture(padded.tobytes(), v4l2.PixelFormat("YUYV", 16, 16, 38)))
    assert picture.shape == (16, 16, 3)
    assert np.abs(picture.astype(int) - [0, 0, 255]).max() < 12

    grey = np.tile(np.arange(0, 64, 4, dtype=np.uint8), (16, 1))
    picture = decoded(RawPicture(grey.tobytes(), v4l2.PixelFormat("GREY", 16, 16, 16)))
    assert np.abs(picture.astype(int) - grey).max() < 8

    nv12 = np.concatenate([np.full((16, 16), 76), np.tile([85, 255], (8, 8))]).astype(np.uint8)
    picture = decoded(RawPicture(nv12.tobytes(), v4l2.PixelFormat("NV12", 16, 16, 16)))
    assert np.abs(picture.astype(int) - [0, 0, 255]).max() < 12


def decoded(picture: RawPicture) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(picture.encode(), np.uint8), cv2.IMREAD_UNCHANGED)
