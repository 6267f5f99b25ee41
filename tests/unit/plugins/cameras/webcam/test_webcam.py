"""Webcams over stand-ins of OpenCV's three backends; the real V4L2 one is in tests/nightly/drivers."""

import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.cameras.frames import CapturedFrame, JpegPicture, PixelPicture
from capture_app.cameras.specs import open_camera, parse_spec
from capture_app.common.camera_facts import PhaseControl, StampSource, TimestampSource
from capture_app.common.clock import HostClock
from capture_app.common.errors import BadInputError, CameraError, NotAvailableError
from capture_app.plugins.cameras.webcam import webcam_driver
from capture_app.sync.wire.camera_commands import RestartStream
from tests.images import small_jpeg
from tests.unit.plugins.cameras.webcam.fake_opencv import BACKENDS, FakeCapture
from tests.waiting import until

JPEG = small_jpeg(b"what a camera calls pixels")
NAMES = {0: "HD Pro Webcam", 1: "Built-in", 3: "HD Pro Webcam"}
FIRST = webcam_driver.RATE_FRAMES + 1
"""Number of frames that show the rate and are not delivered."""
Plug = Callable[..., FakeCapture]
Streaming = tuple[Any, list[CapturedFrame], list[Exception]]


@pytest.fixture
def plug(monkeypatch: pytest.MonkeyPatch) -> Plug:
    """Makes this machine one of that system, with one camera to open."""

    def on(system: str, **settings: Any) -> FakeCapture:
        capture = FakeCapture(BACKENDS[system], jpeg=JPEG, **settings)

        def opened(number: int, backend: int) -> FakeCapture:
            assert (number, backend) == (1, capture.backend)
            return capture

        monkeypatch.setattr(sys, "platform", system)
        monkeypatch.setattr(cv2, "VideoCapture", opened)
        monkeypatch.setattr(cv2.videoio_registry, "hasBackend", lambda backend: backend == capture.backend)
        monkeypatch.setattr(webcam_driver, "camera_names", lambda: NAMES)
        return capture

    return on


@asynccontextmanager
async def streaming(spec: str = "webcam:1") -> AsyncIterator[Streaming]:
    camera = open_camera(spec, clock=HostClock(), name="a")
    frames: list[CapturedFrame] = []
    failures: list[Exception] = []
    try:
        await camera.start(frames.append, failures.append)
        yield camera, frames, failures
    finally:
        await camera.stop()


@pytest.mark.parametrize(
    ("system", "pixel_format", "picture"),
    [("win32", "MJPG", PixelPicture), ("darwin", "", PixelPicture), ("linux", "MJPG", JpegPicture)],
)
async def test_each_system_delivers_frames_with_facts(
    plug: Plug, system: str, pixel_format: str, picture: type
) -> None:
    capture = plug(system)
    async with streaming("webcam:built") as (camera, frames, failures):
        await until(lambda: len(frames) >= 5)
        facts = camera.facts
    assert (facts.kind, facts.model, facts.pixel_format) == ("webcam", "Built-in", pixel_format)
    assert (facts.width, facts.height) == (640, 480)
    assert (facts.phase_control, facts.timestamp_source) == (PhaseControl.NONE, TimestampSource.UNKNOWN)
    assert all(isinstance(frame.picture, picture) for frame in frames)
    assert capture.was_released
    assert not failures


@pytest.mark.parametrize("system", ["win32", "darwin", "linux"])
async def test_the_bar_of_a_stamp_contains_the_arrival_also_after_a_stall(plug: Plug, system: str) -> None:
    """A frame that had waited in a buffer is late by up to the stall, and the thread may wake up late."""
    capture = plug(system)
    capture.stalls_s[FIRST + 10] = 0.13
    async with streaming() as (_, frames, _):
        await until(lambda: len(frames) >= 25)
    arrived_ns = capture.arrived_ns[FIRST:]
    late_ns = [frame.timestamp_ns - at_ns for frame, at_ns in zip(frames, arrived_ns, strict=False)]
    assert min(late_ns) > -1_000_000
    if system != "darwin":
        assert max(late_ns) > 50_000_000, "a frame did wait"
    for late, frame in zip(late_ns, frames, strict=True):
        # What the first frames and the machine's own wake-ups were late by is not in it.
        assert late <= frame.clock_uncertainty_ns + 5_000_000
    assert sorted(frame.clock_uncertainty_ns for frame in frames)[5] < 5_000_000
    assert len({frame.sequence for frame in frames}) == len(frames)


async def test_only_linux_delivers_the_cameras_own_jpegs(plug: Plug) -> None:
    plug("linux")
    async with streaming() as (_, frames, _):
        await until(lambda: frames)
    assert frames[0].picture.encode() == JPEG


async def test_pixels_are_encoded_and_reduced(plug: Plug) -> None:
    plug("win32")
    async with streaming() as (_, frames, _):
        await until(lambda: frames)
    jpeg = np.frombuffer(frames[0].picture.encode(), np.uint8)
    assert cv2.imdecode(jpeg, cv2.IMREAD_COLOR).shape == (480, 640, 3)
    assert frames[0].picture.reduced(320).shape == (240, 320, 3)


async def test_a_damaged_jpeg_is_a_gap(plug: Plug) -> None:
    capture = plug("linux")
    async with streaming() as (_, frames, _):
        await until(lambda: len(frames) >= 2)
        whole, capture.jpeg = capture.jpeg, JPEG[:-2]
        count = len(capture.arrived_ns)
        await until(lambda: len(capture.arrived_ns) >= count + 3)
        capture.jpeg = whole
        count = len(frames)
        await until(lambda: len(frames) >= count + 3)
    numbers = [frame.sequence for frame in frames]
    assert max(after - before for before, after in pairwise(numbers)) >= 3
    assert all(frame.picture.encode() == JPEG for frame in frames)


async def test_the_assumed_delay_is_whatever_fits_between_exposure_and_arrival(plug: Plug) -> None:
    """Exposure, readout, transfer, decoder and one held frame are five periods, and 5 ms of delivery."""
    plug("win32")
    async with streaming() as (camera, _, _):
        stamp, period_ns = camera.facts.stamp_accuracy, camera.facts.period_ns
    assert stamp.source is StampSource.ASSUMED
    assert stamp.bias_ns == stamp.uncertainty_ns == pytest.approx((5 * period_ns + 5_000_000) / 2, abs=5)
    assert camera.facts.start_offset_ns() == -stamp.bias_ns


async def test_the_rate_is_what_arrives_not_what_the_system_says(plug: Plug) -> None:
    plug("win32", fps=25.0)
    async with streaming("webcam:1") as (camera, _, _):
        assert camera.facts.period_ns == pytest.approx(40_000_000, rel=0.2)


@pytest.mark.parametrize(
    ("system", "spec", "needle"),
    [
        ("win32", "webcam:1,fps=30", "it delivers MJPG 640x480 at "),
        ("darwin", "webcam:1,format=MJPG", "does not deliver what was requested"),
    ],
)
async def test_a_mode_that_the_camera_does_not_take_is_refused(
    plug: Plug, system: str, spec: str, needle: str
) -> None:
    plug(system)
    with pytest.raises(CameraError) as error:
        async with streaming(spec):
            pass
    assert needle in str(error.value)


async def test_directshow_gets_the_format_last_because_it_would_forget_it(plug: Plug) -> None:
    plug("win32")
    async with streaming("webcam:1,width=320,height=240,format=mjpg") as (camera, frames, _):
        await until(lambda: frames)
        assert (camera.facts.width, camera.facts.height, camera.facts.pixel_format) == (320, 240, "MJPG")


async def test_a_camera_that_does_not_open_says_what_to_do(plug: Plug) -> None:
    capture = plug("darwin", is_open=False)
    with pytest.raises(CameraError, match="System Settings, Privacy & Security, Camera"):
        async with streaming():
            pass
    assert capture.was_released


async def test_a_camera_that_falls_silent_fails_once(plug: Plug, monkeypatch: pytest.MonkeyPatch) -> None:
    capture = plug("linux")
    async with streaming() as (camera, frames, failures):
        await until(lambda: frames)
        monkeypatch.setattr(webcam_driver, "SILENCE_NS", 100_000_000)
        capture.is_silent = True
        await until(lambda: failures)
        with pytest.raises(CameraError, match="cannot be moved"):
            await camera.apply(RestartStream(delay_ns=0))
    assert [str(one) for one in failures] == [
        "webcam:1 (Built-in) sends no frames (unplug it and plug it in again)"
    ]
    await camera.stop()


async def test_a_camera_that_never_sends_a_frame_does_not_start(
    plug: Plug, monkeypatch: pytest.MonkeyPatch
) -> None:
    plug("win32").is_silent = True
    monkeypatch.setattr(webcam_driver, "SILENCE_NS", 100_000_000)
    with pytest.raises(CameraError, match="sends no frames"):
        async with streaming():
            pass


def test_a_name_or_a_part_of_it_chooses_a_camera() -> None:
    assert webcam_driver.number_of("built", NAMES) == 1
    names = {2: "HD Pro", 5: "HD Pro Webcam"}
    assert webcam_driver.number_of("HD pro", names) == 2, "a whole name comes first"


@pytest.mark.parametrize(
    ("device", "names", "needle"),
    [
        ("hd pro", NAMES, "2 webcams are called 'hd pro' (write webcam:0 (HD Pro Webcam) or webcam:3"),
        ("C920", NAMES, "no webcam is called 'C920' (write webcam:0 (HD Pro Webcam) or webcam:1 (Built-in)"),
        ("C920", {}, "write webcam:0"),
    ],
)
def test_a_name_that_is_not_one_camera_lists_them(device: str, names: dict[int, str], needle: str) -> None:
    with pytest.raises(CameraError) as error:
        webcam_driver.number_of(device, names)
    assert needle in str(error.value)


def test_what_the_system_or_its_opencv_lacks_is_said(plug: Plug, monkeypatch: pytest.MonkeyPatch) -> None:
    plug("win32")
    monkeypatch.setattr(cv2.videoio_registry, "hasBackend", lambda backend: False)
    with pytest.raises(NotAvailableError, match="DirectShow"):
        open_camera("webcam:1", clock=HostClock(), name="a")
    monkeypatch.setattr(sys, "platform", "freebsd14")
    with pytest.raises(NotAvailableError, match="freebsd14"):
        open_camera("webcam:1", clock=HostClock(), name="a")


@pytest.mark.parametrize(("system", "count"), [("win32", 3), ("darwin", 3), ("linux", 0)])
def test_cameras_are_listed_by_name_where_no_better_driver_lists_them(
    plug: Plug, system: str, count: int
) -> None:
    plug(system)
    listed = [(one.spec, one.model) for one in webcam_driver.list_cameras()]
    assert listed == [(f"webcam:{number}", name) for number, name in NAMES.items()][:count]


def test_the_first_words_of_other_programs_are_answered() -> None:
    with pytest.raises(BadInputError, match=r"write webcam:0\)"):
        parse_spec("0")
    with pytest.raises(BadInputError, match="webcam:NUMBER_OR_NAME"):
        parse_spec("webcam")
    assert parse_spec("webcam:0").label == "webcam-0"
