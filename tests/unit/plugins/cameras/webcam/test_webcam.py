"""Webcams by OpenCV: arrival stamps, restarts by opening anew, and how little is promised."""

import threading
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from capture_app.cameras.frames import CapturedFrame
from capture_app.cameras.specs import CameraRequest, open_camera
from capture_app.common.camera_facts import PhaseControl, StampSource, TimestampSource
from capture_app.common.clock import HostClock
from capture_app.common.errors import BadInputError, CameraError
from capture_app.machine.cameras import list_cameras
from capture_app.plugins.cameras.webcam import Webcam, WebcamCamera
from capture_app.sync.wire.camera_commands import RestartStream, SetFrameDuration
from tests.waiting import TIMEOUT_S, time_limit, until


class FakeWebcam(Webcam):
    """Gives grey pictures as fast as they are asked for, until it is unplugged."""

    index, fps = 3, 25.0

    def __init__(self) -> None:
        self.closed = self.unplugged = False
        self.opened_ns = time.monotonic_ns()
        self.may_close = threading.Event()
        self.may_close.set()

    def next_frame(self) -> tuple[int, NDArray[np.uint8]] | None:
        assert not self.closed
        if self.unplugged:
            return None
        time.sleep(0.002)
        return time.monotonic_ns(), np.full((48, 64, 3), 90, np.uint8)

    def close(self) -> None:
        assert self.may_close.wait(TIMEOUT_S)
        self.closed = True


class Streaming:
    """A camera, the webcams that were opened for it, and what it delivered."""

    def __init__(self) -> None:
        self.opened: list[FakeWebcam] = []
        self.missing = False
        self.frames: list[CapturedFrame] = []
        self.failures: list[Exception] = []
        self.camera = WebcamCamera(self.open)

    def open(self) -> FakeWebcam:
        if self.missing:
            raise CameraError("webcam 3 does not open")
        self.opened.append(FakeWebcam())
        return self.opened[-1]

    async def start(self) -> None:
        await self.camera.start(self.frames.append, self.failures.append)
        await until(lambda: len(self.frames) >= 3)


@pytest.fixture
async def streaming() -> AsyncIterator[Streaming]:
    one = Streaming()
    yield one
    await one.camera.stop()
    assert all(webcam.closed for webcam in one.opened)


async def test_frames_are_stamped_as_they_arrive_and_no_more_is_promised(streaming: Streaming) -> None:
    begun_ns = time.monotonic_ns()
    await streaming.start()
    facts = streaming.camera.facts
    assert (facts.kind, facts.width, facts.height, facts.period_ns) == ("webcam", 64, 48, 40_000_000)
    assert (facts.timestamp_source, facts.phase_control) == (TimestampSource.UNKNOWN, PhaseControl.RESET)
    assert facts.stamp_accuracy.source is StampSource.ASSUMED
    assert facts.stamp_accuracy.uncertainty_ns > 20_000_000, "tens of milliseconds"
    stamps = [frame.timestamp_ns for frame in streaming.frames]
    assert stamps == sorted(stamps)
    assert begun_ns < stamps[0]
    assert [frame.sequence for frame in streaming.frames[:3]] == [0, 1, 2]
    picture = streaming.frames[0].picture
    assert picture.held_bytes == 64 * 48 * 3
    assert picture.reduced(32).shape == (24, 32, 3)
    decoded = cv2.imdecode(np.frombuffer(picture.encode(), np.uint8), cv2.IMREAD_COLOR)
    assert abs(float(decoded.mean()) - 90) < 1


async def test_a_restart_opens_it_anew_at_the_time_asked_for(streaming: Streaming) -> None:
    await streaming.start()
    asked_ns = time.monotonic_ns()
    await streaming.camera.apply(RestartStream(50_000_000))
    await until(lambda: streaming.frames[-1].stream == 1)
    assert [webcam.closed for webcam in streaming.opened] == [True, False]
    assert streaming.opened[1].opened_ns >= asked_ns + 50_000_000
    assert next(frame for frame in streaming.frames if frame.stream == 1).sequence == 0
    with pytest.raises(CameraError, match="cannot change single frames"):
        await streaming.camera.apply(SetFrameDuration(1))


async def test_one_that_goes_away_is_told(streaming: Streaming) -> None:
    await streaming.start()
    webcam = streaming.opened[0]
    webcam.may_close.clear()
    webcam.unplugged = True
    await until(lambda: streaming.failures)
    assert "webcam 3 gives no pictures" in str(streaming.failures[0])
    async with time_limit("a refusal while it is being closed"):
        with pytest.raises(CameraError, match="does not stream"):
            await streaming.camera.apply(RestartStream(0))
    webcam.may_close.set()


async def test_one_that_does_not_open_is_told(streaming: Streaming) -> None:
    streaming.missing = True
    with pytest.raises(CameraError, match="before it starts"):
        _ = streaming.camera.facts
    with pytest.raises(CameraError, match="does not open"):
        await streaming.camera.start(streaming.frames.append, streaming.failures.append)


async def test_one_that_is_gone_at_a_restart_is_told(streaming: Streaming) -> None:
    await streaming.start()
    streaming.missing = True
    await streaming.camera.apply(RestartStream(0))
    await until(lambda: streaming.failures)
    assert "does not open" in str(streaming.failures[0])


def test_opencvs_own_capture_gives_what_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "clip.avi"
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (64, 48))
    video.write(np.full((48, 64, 3), 200, np.uint8))
    video.release()
    # A file stands in for the device: the class and its calls are OpenCV's.
    real: Callable[[str], cv2.VideoCapture] = cv2.VideoCapture
    monkeypatch.setattr(cv2, "VideoCapture", lambda index: real(str(path) if index == 2 else "/dev/none"))
    webcam = Webcam(2, CameraRequest(fps=15.0))
    assert webcam.fps == 20.0, "what it tells, not what was asked for"
    before_ns = time.monotonic_ns()
    found = webcam.next_frame()
    assert found is not None
    assert before_ns <= found[0] <= time.monotonic_ns()
    assert found[1].shape == (48, 64, 3)
    assert webcam.next_frame() is None
    webcam.close()
    with pytest.raises(CameraError, match="webcam 5 does not open"):
        Webcam(5, CameraRequest())


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        ("webcam:front", "they have numbers"),
        ("webcam:0,rate=3", "no option 'rate'.*width, height, fps"),
        ("webcam:0,fps=0", "fps=0 of a webcam"),
    ],
)
def test_what_cannot_be_read_is_refused_in_words(spec: str, says: str) -> None:
    with pytest.raises(BadInputError, match=says):
        open_camera(spec, clock=HostClock(), name="cam")


def test_where_there_is_a_better_driver_none_is_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("platform.system", lambda: "Linux")
    assert not [one for one in list_cameras() if one.kind == "webcam"]
