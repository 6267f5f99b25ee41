"""The option `sound` of a camera: what it names, and what a microphone that fails does to its camera."""

import asyncio
import logging
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from capture_app.cameras.frames import CapturedFrame
from capture_app.cameras.specs import open_camera, parse_spec
from capture_app.common.clock import HostClock, SimulatedClock
from capture_app.common.errors import BadInputError, CameraError, NotAvailableError
from capture_app.plugins.cameras.sound.image_sound import SoundPart, sounds_of
from capture_app.plugins.cameras.sound.microphones import AlsaMicrophone, partner_device
from capture_app.plugins.cameras.sound.sound_camera import SoundCamera
from tests.unit.cameras.fake_camera import FakeCamera
from tests.waiting import until

CLOCK = HostClock()
ARECORD = """#!{python}
import os, sys, time
open({log!r}, "a").write(" ".join([str(os.getpid()), *sys.argv[1:]]) + chr(10))
if not os.path.exists({plugged!r}):
    sys.exit("arecord: main:850: audio open error: No such file or directory")
begin, sent = time.monotonic(), 0
while os.path.exists({plugged!r}):
    due = int((time.monotonic() - begin) * 48000) // 960 * 960
    sys.stdout.buffer.write(b"\\x11\\x22" * (due - sent))
    sys.stdout.buffer.flush()
    sent = due
    time.sleep(0.02)
sys.stderr.write("arecord: pcm_read:2221: read error: No such device" + chr(10))
"""


@pytest.fixture
def arecord(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A program in place of ALSA's; it records while the file that is returned exists."""
    program, plugged = tmp_path / "arecord", tmp_path / "plugged"
    program.write_text(ARECORD.format(python=sys.executable, log=str(tmp_path / "log"), plugged=str(plugged)))
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    plugged.touch()
    return plugged


def plug(plugged: Path, *, there: bool) -> None:
    plugged.touch() if there else plugged.unlink()


class Delivered:
    """A fake camera with a microphone, and the sound of the images that it takes."""

    def __init__(self, microphone: AlsaMicrophone) -> None:
        self.inner = FakeCamera()
        self.camera = SoundCamera(self.inner, microphone, "left", retry_s=0.1)
        self.frames: list[CapturedFrame] = []

    def shoot(self) -> list[SoundPart]:
        jpeg = b"\xff\xd8\xff\xdb\x00\x02"

        class Picture:
            held_bytes = 6

            def encode(self) -> bytes:
                return jpeg

            def reduced(self, width: int) -> np.ndarray:
                return np.zeros((1, width, 3), np.uint8)

        self.inner.on_frame(CapturedFrame(len(self.frames), 0, CLOCK.now_ns(), Picture()))
        return sounds_of(self.frames[-1].picture.encode())


async def test_the_images_of_any_camera_carry_its_microphones_sound(arecord: Path) -> None:
    it = Delivered(AlsaMicrophone("hw:1", CLOCK))
    await it.camera.start(it.frames.append, lambda _: None)
    try:
        await until(lambda: bool(it.shoot()))
    finally:
        await it.camera.stop()
    given = (arecord.parent / "log").read_text().split()
    assert given[given.index("-D") + 1] == "plughw:1"
    parts = [part for frame in it.frames for part in sounds_of(frame.picture.encode())]
    assert {bytes(part.pcm[:2]) for part in parts} == {b"\x11\x22"}
    assert abs(parts[-1].local_ns - it.frames[-1].timestamp_ns) < 2e9


async def test_a_camera_goes_on_while_its_microphone_is_unplugged(
    arecord: Path, caplog: pytest.LogCaptureFixture
) -> None:
    log = arecord.parent / "log"
    it = Delivered(AlsaMicrophone("hw:1", CLOCK))
    caplog.set_level(logging.WARNING)
    await it.camera.start(it.frames.append, lambda _: None)
    try:
        await until(lambda: bool(it.shoot()))
        plug(arecord, there=False)
        await until(lambda: log.read_text().count("\n") > 3)
        assert it.shoot() == []
        plug(arecord, there=True)
        await until(lambda: bool(it.shoot()))
    finally:
        await it.camera.stop()
    said = [record.getMessage() for record in caplog.records]
    assert len(said) == 2
    assert "left: images have no sound for now" in said[0]
    assert "No such device" in said[0]
    assert said[1] == "left: the microphone is back"


async def test_arecord_ends_with_its_camera(arecord: Path) -> None:
    it = Delivered(AlsaMicrophone("hw:1", CLOCK))
    await it.camera.start(it.frames.append, lambda _: None)
    await until(lambda: bool(it.shoot()))
    child = Path("/proc") / (arecord.parent / "log").read_text().split()[0]
    assert child.exists()
    await it.camera.stop()
    await until(lambda: not child.exists())


def test_without_arecord_the_error_names_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nonexistent")
    with pytest.raises(NotAvailableError, match=r"arecord.*apt install alsa-utils"):
        open_camera("sim:pi,sound=hw:1", clock=CLOCK, name="a")


async def test_a_simulated_camera_hears_clicks_at_whole_seconds() -> None:
    clock = SimulatedClock(offset_ns=3_600_000_000_000, skew_ppm=30.0)
    camera = open_camera("sim:phone-a,drops=0,scale=0.1,sound=sim", clock=clock, name="a")
    frames: list[CapturedFrame] = []
    await camera.start(frames.append, lambda _: None)
    try:
        await asyncio.sleep(2.2)
    finally:
        await camera.stop()
    parts = [part for frame in frames for part in sounds_of(frame.picture.encode())]
    clicks = [
        clock.true_from_local(
            part.local_ns + round(1e9 * np.flatnonzero(np.frombuffer(part.pcm, "<i2"))[0] / 48_000)
        )
        for part in parts
        if any(part.pcm)
    ]
    assert clicks
    assert [click % 10**9 for click in clicks] == pytest.approx([0] * len(clicks), abs=50_000_000)


def test_a_spec_has_a_microphone_and_the_drivers_own_options() -> None:
    assert parse_spec("v4l2:/dev/video0,sound=hw:1,fps=30").options == {"sound": "hw:1", "fps": "30"}
    with pytest.raises(BadInputError, match="no option 'sounds'"):
        open_camera("sim:pi,sounds=sim", clock=CLOCK, name="a")


def test_the_microphone_of_a_usb_camera_is_found(tmp_path: Path, arecord: Path) -> None:
    usb = tmp_path / "devices" / "1-4"
    (usb / "1-4:1.2" / "sound" / "card3").mkdir(parents=True)
    (usb / "1-4:1.0").mkdir()
    for name, of in (("video0", usb / "1-4:1.0"), ("video5", tmp_path / "devices" / "other")):
        (tmp_path / "classes" / name).mkdir(parents=True)
        (tmp_path / "classes" / name / "device").symlink_to(of)
    assert partner_device("/dev/video0", tmp_path / "classes") == "hw:3"
    with pytest.raises(CameraError, match="/dev/video5 has no microphone"):
        partner_device("/dev/video5", tmp_path / "classes")
    with pytest.raises(CameraError, match=r"sim cameras have no microphone.*sound=hw:1"):
        open_camera("sim:pi,sound=own", clock=CLOCK, name="a")
