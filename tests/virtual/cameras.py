"""Cameras of a virtual rig: a simulated sensor whose images are ready-made, and say when they were taken."""

import asyncio
import struct
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import structs

from capture_app.cameras.base import OnFailure, OnFrame
from capture_app.cameras.frames import CapturedFrame, FramePicture, JpegPicture
from capture_app.common.camera_facts import EXACT_STAMPS, PhaseControl
from capture_app.common.errors import CameraError
from capture_app.plugins.cameras.sim.profiles import SensorProfile
from capture_app.plugins.cameras.sim.rendering.picture_source import PictureSource
from capture_app.plugins.cameras.sim.sensor import Sensor, SensorFrame
from capture_app.plugins.cameras.sim.simulation_driver import SimulatedCamera
from capture_app.plugins.cameras.sound.sound_camera import SoundPicture
from capture_app.plugins.cameras.sound.sound_ring import SoundRing
from capture_app.session.reading.decoding import encode_image

if TYPE_CHECKING:
    from tests.virtual.world import World

WIDTH, HEIGHT = 64, 48
_MARK = b"virtual rig "
_STAMP = struct.Struct(">12sq16s")
SOUND_HZ, SOUND_BLOCK_S = 8_000, 0.1
PROFILE = SensorProfile(
    name="virtual",
    model="Virtual camera",
    phase_control=PhaseControl.INJECTION,
    row_time_ns=33_333,
    frame_length_rows=3000,
    margin_rows=10,
    max_exposure_ns=400_000_000,
    start_latency_ns=(300_000_000, 20_000_000),
    timestamp_noise_ns=3_000,
    period_error_ppm=20.0,
)
"""Ten frames a second: a third of the work of thirty, and the same behaviour."""


@cache
def _jpeg() -> bytes:
    shade = np.linspace(0, 255, WIDTH * HEIGHT * 3).reshape(HEIGHT, WIDTH, 3)
    return encode_image(shade.astype(np.uint8))


class ReadyPicture(PictureSource):
    """A small JPEG with a comment that names its camera and the true time, and padding."""

    def __init__(self, camera: str, image_bytes: int, lie: str) -> None:
        super().__init__(WIDTH, HEIGHT)
        object.__setattr__(self, "_of", (camera, image_bytes, lie))

    def render(self, frame: SensorFrame, *, seed: int) -> Any:
        raise NotImplementedError

    def jpeg(self, frame: SensorFrame) -> bytes:
        """Return the JPEG of a frame."""
        camera, size, lie = self._of  # type: ignore[attr-defined]
        if lie == "cut-image":
            return _jpeg()[: 200 + frame.sequence % 50]
        mark = _STAMP.pack(_MARK, frame.start_true_ns, camera.encode())
        comments = b"\xff\xfe" + struct.pack(">H", len(mark) + 2) + mark
        left = size - len(_jpeg()) - len(comments)
        while left > 0:
            part = min(left, 60_000)
            comments += b"\xff\xfe" + struct.pack(">H", part + 2) + bytes(part)
            left -= part
        return _jpeg()[:2] + comments + _jpeg()[2:]


def true_ns_of(image: bytes) -> tuple[str, int] | None:
    """Return camera and true start of the exposure of a virtual camera's image; None of any other."""
    # After the sound, if there is any.
    at = image.find(b"\xff\xfe\x00" + bytes([_STAMP.size + 2]) + _MARK)
    if at < 0:
        return None
    _, true_ns, camera = _STAMP.unpack_from(image, at + 4)
    return camera.rstrip(b"\0").decode(), true_ns


def sound_number(true_ns: int) -> int:
    """Return the number of the sample at a true time."""
    return true_ns * SOUND_HZ // 1_000_000_000


class Device:
    """What befalls a camera, whoever has it open."""

    def __init__(self) -> None:
        self.is_stalled = self.is_lost = False
        self.opened: VirtualCamera | None = None
        self.delivered_ns: list[int] = []
        """True time of the start of each frame that it delivered."""


class VirtualCamera(SimulatedCamera):
    """A camera of a virtual rig, in the clock of its machine."""

    def __init__(
        self,
        world: "World",
        name: str,
        clock: Any,
        device: Device,
        *,
        drops: float,
        image_bytes: int,
        lie: str,
        has_sound: bool = False,
    ) -> None:
        if device.is_lost:
            raise CameraError("the camera is not connected", hint="connect it")
        profile = replace(PROFILE, drop_fraction=drops)
        self._world, self._device, self._clock_of_machine = world, device, clock
        self._sound = SoundRing(SOUND_HZ) if has_sound else None
        self._listening: asyncio.Task[None] | None = None
        device.opened = self
        self._pictures = ReadyPicture(name, image_bytes, lie)
        super().__init__(
            Sensor(profile, world.chance("sensor", name, world.now_ns)),
            self._pictures,
            clock,
            seed=len(name),
        )
        # Not a simulated one to the product, which would give it a true clock; its stamps are exact, though.
        self._facts = structs.replace(self.facts, kind="v4l2", stamp=EXACT_STAMPS)
        if lie == "huge":
            self._facts = structs.replace(self.facts, width=1 << 20, height=1 << 20)
        elif lie == "wrong-size":
            self._facts = structs.replace(self.facts, width=640, height=480)

    @property
    def calibration(self) -> None:
        """No calibration: these images show nothing."""

    def _captured(self, frame: SensorFrame) -> CapturedFrame:
        """Return a frame whose picture is ready-made."""
        return replace(super()._captured(frame), picture=JpegPicture(self._pictures.jpeg(frame)))

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Start streaming."""

        def pass_on(frame: CapturedFrame) -> None:
            if self._device.is_stalled:
                return
            assert frame.true_ns is not None
            if self._clock_of_machine.is_asleep(frame.true_ns):
                return
            self._device.delivered_ns.append(frame.true_ns)
            picture: FramePicture = frame.picture
            if self._sound is not None:
                picture = SoundPicture(picture, frame.timestamp_ns, self._sound)
            on_frame(replace(frame, picture=picture, encode_truth=None, true_ns=None))

        await super().start(pass_on, on_failure)
        if self._sound is not None:
            self._listening = asyncio.create_task(self._listen(self._sound))

    async def stop(self) -> None:
        """Stop the camera and its microphone."""
        if self._listening is not None:
            self._listening.cancel()
        await super().stop()

    async def _listen(self, ring: SoundRing) -> None:
        """Record a microphone's blocks; each sample is its own number, modulo 2 ** 15."""
        ring.begin_stream()
        heard = sound_number(self._world.now_ns)
        while True:
            await asyncio.sleep(SOUND_BLOCK_S)
            until = sound_number(self._world.now_ns)
            samples = (np.arange(heard, until) & 0x7FFF).astype("<i2")
            ring.add(samples.tobytes(), self._clock_of_machine.now_ns())
            heard = until

    def fail(self) -> None:
        """Go away, as a camera that is unplugged."""
        if self._started:
            self._halt()
            self._on_failure(CameraError("the camera went away"))

    def _true_now_ns(self) -> int:
        return self._world.now_ns
