"""The option `sound` of every camera: its images carry the sound of a microphone beside it."""

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from capture_app.cameras.base import Camera, DeviceClock, OnFailure, OnFrame
from capture_app.cameras.frames import CapturedFrame, FramePicture
from capture_app.cameras.specs import CameraSpec
from capture_app.common.camera_facts import CameraFacts, Control, ControlState
from capture_app.common.clock import NodeClock
from capture_app.common.errors import CameraError, SimulshotError
from capture_app.plugins.cameras.sound.image_sound import add_segments
from capture_app.plugins.cameras.sound.microphones import Microphone, open_microphone
from capture_app.plugins.cameras.sound.sound_ring import SoundRing
from capture_app.session.format.calibration import CameraCalibration
from capture_app.sync.wire.camera_commands import CameraCommand

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

HELP = (
    "Its images carry the sound of a microphone: own (of a USB or IP camera), hw:1 (see arecord -l), or sim."
)
RETRY_S = 5.0
_log = logging.getLogger(__name__)


@dataclass(slots=True)
class SoundPicture:
    """An image that is encoded with the sound before it."""

    picture: FramePicture
    local_ns: int
    ring: SoundRing
    _segments: bytes | None = None
    _once: threading.Lock = field(default_factory=threading.Lock)

    @property
    def held_bytes(self) -> int:
        """Memory that the image takes, in bytes."""
        return self.picture.held_bytes

    def encode(self) -> bytes:
        """Return the image's bytes with its sound, the same ones each time."""
        jpeg = self.picture.encode()
        with self._once:
            if self._segments is None:
                self._segments = self.ring.carry(self.local_ns)
        return add_segments(jpeg, self._segments)

    def reduced(self, width: int) -> "NDArray[np.uint8]":
        """Return the image as `FramePicture.reduced` does, without sound."""
        return self.picture.reduced(width)


class SoundCamera(Camera):
    """A camera with a microphone, which is tried again if it fails, while the camera goes on."""

    def __init__(
        self, camera: Camera, microphone: Microphone, name: str, *, retry_s: float = RETRY_S
    ) -> None:
        """`name` is the node's, for the log."""
        self._camera, self._microphone, self._name, self._retry_s = camera, microphone, name, retry_s
        self._ring = SoundRing()
        self._closing = threading.Event()

    @property
    def facts(self) -> CameraFacts:
        """Facts of the camera."""
        return self._camera.facts

    @property
    def calibration(self) -> CameraCalibration | None:
        """Calibration of the camera."""
        return self._camera.calibration

    @property
    def device_clock(self) -> DeviceClock | None:
        """Accuracy of the camera's clock."""
        return self._camera.device_clock

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Start the camera, and the microphone with it. Raises as the camera does."""

        def with_sound(frame: CapturedFrame) -> None:
            on_frame(replace(frame, picture=SoundPicture(frame.picture, frame.timestamp_ns, self._ring)))

        await self._camera.start(with_sound, on_failure)
        threading.Thread(target=self._listen, name=f"sound of {self._name}", daemon=True).start()

    async def apply(self, command: CameraCommand) -> None:
        """Send a phase command to the camera."""
        await self._camera.apply(command)

    async def controls(self) -> tuple[ControlState, ...]:
        """Return the camera's controls."""
        return await self._camera.controls()

    async def set_control(self, control: Control, value: float | None) -> None:
        """Set a control of the camera."""
        await self._camera.set_control(control, value)

    async def stop(self) -> None:
        """Stop the camera and the microphone. Calling it twice is harmless."""
        self._closing.set()
        await self._camera.stop()

    def _listen(self) -> None:
        is_lost = False

        def on_sound(pcm: bytes, arrival_ns: int) -> None:
            nonlocal is_lost
            if is_lost:
                is_lost = False
                _log.warning("%s: the microphone is back", self._name)
            self._ring.add(pcm, arrival_ns)

        while not self._closing.is_set():
            self._ring.begin_stream()
            try:
                self._microphone.listen(on_sound, self._closing)
            except (SimulshotError, OSError) as error:
                if not is_lost:
                    _log.warning("%s: images have no sound for now: %s", self._name, error)
                is_lost = True
                self._closing.wait(self._retry_s)


def wrapper(text: str, spec: CameraSpec, *, clock: NodeClock, name: str) -> Callable[[Camera], Camera]:
    """Return what adds the microphone that the option names to an opened camera.

    Raises as `open_microphone` does.
    """
    microphone = open_microphone(text, spec, clock)

    def wrap(camera: Camera) -> Camera:
        own = microphone or getattr(camera, "microphone", None)
        if own is None:
            raise CameraError(
                f"{spec.kind} cameras have no microphone that is known",
                hint="name one, as sound=hw:1; arecord -l lists them",
            )
        return SoundCamera(camera, own, name)

    return wrap
