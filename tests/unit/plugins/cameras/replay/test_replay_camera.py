"""A session or a video as a live camera, opened as users open it."""

import asyncio
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from capture_app.cameras.base import Camera
from capture_app.cameras.frames import CapturedFrame
from capture_app.cameras.specs import open_camera
from capture_app.common.camera_facts import PhaseControl, StampAccuracy, StampSource
from capture_app.common.clock import HostClock, SimulatedClock
from capture_app.common.errors import BadInputError, CameraError
from capture_app.machine.cameras import list_cameras
from capture_app.session.format.manifest import BurstRecord
from capture_app.session.reading import decoding
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.wire.camera_commands import InjectFrame, RestartStream, SetFrameDuration
from tests.unit.session.conftest import camera_record, jpeg
from tests.waiting import until

pytestmark = pytest.mark.virtual

PERIOD_NS = 10_000_000
ERRORS_NS = (0, 40_000, -30_000, 10_000)


MEASURED = StampAccuracy(bias_ns=7_000_000, uncertainty_ns=800_000, source=StampSource.MOTION)


@pytest.fixture
def session(tmp_path: Path) -> Session:
    """Four instants of two cameras, ten periods apart; `right` is 300 us late and lacks the third.

    The stamps of `right` are known to be 7 ms late.
    """
    writer = SessionWriter.create(tmp_path, "taken")
    instants_ns = tuple(5_000_000_000 + 10 * PERIOD_NS * number for number in range(4))
    for camera, late_ns in (("left", 0), ("right", 300_000)):
        for number, instant_ns in enumerate(instants_ns):
            if (camera, number) != ("right", 2):
                writer.add_image(
                    jpeg(number, 64, 48),
                    camera=camera,
                    instant=number,
                    leader_ns=instant_ns + late_ns + ERRORS_NS[number],
                    residual_ns=late_ns + ERRORS_NS[number],
                    exposure_start_ns=instant_ns + late_ns + ERRORS_NS[number] if late_ns else None,
                    outlier_ns=500 * number,
                    exposure_ns=1_000_000,
                    gain=2.0,
                )
    cameras = [
        camera_record(name, kind="v4l2", width=64, height=48, period_ns=PERIOD_NS, stamp=stamp)
        for name, stamp in (("left", None), ("right", MEASURED))
    ]
    burst = BurstRecord(instants_ns=instants_ns, period_ns=10 * PERIOD_NS)
    return writer.finish(cameras, burst, [], origin="captured")


async def frames_of(camera: Camera, count: int) -> list[CapturedFrame]:
    """The first frames that a camera delivers."""
    frames: list[CapturedFrame] = []
    failures: list[Exception] = []
    await camera.start(frames.append, failures.append)
    await until(lambda: len(frames) >= count or failures)
    await camera.stop()
    assert not failures
    return frames


def spec_of(session: Session, *options: str) -> str:
    return ",".join((f"replay:{session.folder}", *options))


async def test_a_sparse_session_plays_an_instant_a_period_with_its_own_deviations(session: Session) -> None:
    camera = open_camera(spec_of(session), clock=HostClock(), name="right")
    assert (camera.facts.kind, camera.facts.model) == ("replay", "test of taken")
    assert (camera.facts.width, camera.facts.height, camera.facts.period_ns) == (64, 48, PERIOD_NS)
    assert camera.facts.stamp_accuracy == replace(MEASURED, bias_ns=0), "its times are right but for the rest"
    frames = await frames_of(camera, 7)
    pictures = {jpeg(number, 64, 48): number for number in range(4)}
    first = pictures[frames[0].picture.encode()]
    begun_ns = frames[0].timestamp_ns - ERRORS_NS[first] - 500 * first
    for frame in frames:
        number = (first + frame.sequence) % 4
        assert pictures[frame.picture.encode()] == number != 2, "the dropped one is a gap"
        late_ns = frame.timestamp_ns - begun_ns - frame.sequence * PERIOD_NS
        assert late_ns == ERRORS_NS[number] + 500 * number
        assert (frame.exposure_ns, frame.gain, frame.stream) == (1_000_000, 2.0, 0)


async def test_without_phase_control_cameras_of_a_session_keep_their_distance(session: Session) -> None:
    both = [
        open_camera(spec_of(session, "phase=none"), clock=HostClock(), name=name)
        for name in ("left", "right")
    ]
    left, right = await asyncio.gather(*(frames_of(camera, 6) for camera in both))
    apart_ns = {
        (one.timestamp_ns - other.timestamp_ns) % (4 * PERIOD_NS)
        for one in right
        for other in left
        if one.picture.encode() == other.picture.encode()
    }
    assert apart_ns == {300_000}
    with pytest.raises(CameraError, match="does not run"):
        await both[0].apply(SetFrameDuration(1))


async def test_it_is_moved_as_asked_in_the_nodes_own_clock(session: Session) -> None:
    clock = SimulatedClock(3_600_000_000_000, 20.0)
    camera = open_camera(spec_of(session, "phase=reset"), clock=clock, name="left")
    assert camera.facts.phase_control is PhaseControl.RESET
    assert camera.facts.stamp_accuracy.source is StampSource.ASSUMED
    frames: list[CapturedFrame] = []
    await camera.start(frames.append, lambda error: None)
    await until(lambda: len(frames) >= 3)
    before_ns = clock.now_ns()
    await camera.apply(RestartStream(30_000_000))
    await until(lambda: frames[-1].stream == 1)
    first = next(frame for frame in frames if frame.stream == 1)
    assert first.timestamp_ns >= before_ns + 30_000_000
    assert first.sequence == 0
    with pytest.raises(CameraError, match="cannot do that"):
        await camera.apply(InjectFrame(1))
    with pytest.raises(CameraError, match="started already"):
        await camera.start(frames.append, lambda error: None)
    await camera.stop()


async def test_a_video_plays_at_its_own_rate(tmp_path: Path) -> None:
    path = tmp_path / "clip.avi"
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 50.0, (64, 48))
    for number in range(5):
        video.write(np.full((48, 64, 3), 50 * number, np.uint8))
    video.release()
    camera = open_camera(f"replay:{path}", clock=HostClock(), name="cam0")
    assert (camera.facts.width, camera.facts.height, camera.facts.period_ns) == (64, 48, 20_000_000)
    frames = await frames_of(camera, 7)
    first = round(float(frames[0].picture.reduced(64).mean()) / 50)
    for frame in frames:
        assert abs(float(frame.picture.reduced(64).mean()) - 50 * ((first + frame.sequence) % 5)) < 6
    assert {(b.timestamp_ns - a.timestamp_ns) // (b.sequence - a.sequence) for a, b in pairwise(frames)} == {
        20_000_000
    }
    slow = open_camera(f"replay:{path},fps=4", clock=HostClock(), name="cam0")
    assert slow.facts.period_ns == 250_000_000


def test_a_folder_s_jpegs_are_handed_over_as_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each was decoded to see whether it is an image: 8 to 19 ms at 1080p, too much for a rig."""
    images = [jpeg(number, 64, 48) for number in range(4)]
    (tmp_path / "cam").mkdir()
    for number, data in enumerate((*images[:2], images[2][:-200], images[3])):
        (tmp_path / f"cam/{number}.jpg").write_bytes(data)
    camera = open_camera(f"replay:{tmp_path},fps=100", clock=HostClock(), name="cam")
    recording = camera._recording  # type: ignore[attr-defined]
    monkeypatch.setattr(decoding, "decode_image", None)
    pictures = [recording.picture(index) for index in range(4)]
    assert pictures[2] is None, "a broken one is a dropped frame, as of a session"
    del images[2], pictures[2]
    assert [picture.encode() for picture in pictures] == images


async def test_a_picture_that_is_gone_ends_the_stream_in_words(session: Session) -> None:
    camera = open_camera(spec_of(session), clock=HostClock(), name="left")
    for path in (session.folder / "images").rglob("*.jpg"):
        path.unlink()
    failures: list[Exception] = []
    await camera.start(lambda frame: None, failures.append)
    await until(lambda: failures)
    await camera.stop()
    assert "cannot go on" in str(failures[0])


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("fast=1",), "no option 'fast'.*camera, fps, phase"),
        (("fps=0",), "fps=0 of a replay"),
        (("fps=30",), "has times of its own"),
        (("phase=injection",), "one of reset, frame-duration, none"),
        (("camera=middle",), "no camera middle.*left, right"),
        ((), "several cameras.*camera=left"),
    ],
)
def test_what_cannot_be_replayed_is_refused_in_words(
    session: Session, options: tuple[str, ...], says: str
) -> None:
    with pytest.raises(BadInputError, match=says):
        open_camera(spec_of(session, *options), clock=HostClock(), name="node")


def test_no_recording_is_listed_and_none_is_found(tmp_path: Path) -> None:
    assert not [one for one in list_cameras() if one.kind == "replay"]
    with pytest.raises(BadInputError, match="nothing at"):
        open_camera(f"replay:{tmp_path}/none.mp4", clock=HostClock(), name="node")
