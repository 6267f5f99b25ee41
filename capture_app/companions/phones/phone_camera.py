"""A connected phone as a camera of the rig; its images stay on the phone until they are requested."""

import asyncio
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import structs

from capture_app.cameras.base import Camera, DeviceClock, OnFailure, OnFrame
from capture_app.cameras.frames import CapturedFrame
from capture_app.cameras.specs import COMMON_OPTIONS
from capture_app.common.address import Address
from capture_app.common.camera_facts import CameraFacts, Control, ControlState
from capture_app.common.errors import CameraError, SimulshotError
from capture_app.common.plugins import load_plugin
from capture_app.common.tasks import Background, first_of, has_come
from capture_app.common.timeouts import PAGE_CLOSED_S, PHONE_IMAGE_TIMEOUT_S
from capture_app.companions.phones.phone import Phone, PhoneFrame
from capture_app.node.camera.camera_node import CameraNode
from capture_app.node.camera.device_profiles import DeviceProfiles
from capture_app.node.camera.supervisor import NodeOptions
from capture_app.protocol.log import Log
from capture_app.session.reading.decoding import decode_preview
from capture_app.sync.wire.camera_commands import CameraCommand, RestartStream

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_JPEG_START = b"\xff\xd8\xff"
_SLACK_S = 5.0
RETRY_S = 2.0
REPORT_INTERVAL_S = 0.5


@dataclass(frozen=True, slots=True)
class PhonePicture:
    """An image that stays on its phone until it is requested."""

    phone: Phone
    page: str
    id: int
    loop: asyncio.AbstractEventLoop

    @property
    def held_bytes(self) -> int:
        """Memory that the image takes here, in bytes."""
        return 1

    def encode(self) -> bytes:
        """Return the phone's own JPEG. Raises CameraError if it does not arrive."""
        return self._fetch(None)

    def reduced(self, width: int) -> "NDArray[np.uint8]":
        """Return the image as reduced by the phone, BGR uint8 (H, W, 3).

        Raises CameraError if it does not arrive, ValueError if it cannot be decoded.
        """
        picture = decode_preview(self._fetch(width))
        if picture is None:
            raise ValueError("the phone's JPEG cannot be decoded")
        return picture

    def _fetch(self, width: int | None) -> bytes:
        coming = asyncio.run_coroutine_threadsafe(self.phone.fetch(self.page, self.id, width), self.loop)
        try:
            data = coming.result(PHONE_IMAGE_TIMEOUT_S + _SLACK_S)
        except TimeoutError as error:
            coming.cancel()
            raise CameraError(
                f"{self.phone.name} did not send the image", hint="keep its page open and its screen on"
            ) from error
        if not data.startswith(_JPEG_START):
            raise CameraError(
                f"{self.phone.name} sent an image that is not a JPEG",
                hint="update its browser, or use another one",
            )
        return data


class PhoneCamera(Camera):
    """The camera of a connected phone; its timestamps are in the clock of the gateway's host."""

    def __init__(self, phone: Phone) -> None:
        """Take over a phone's camera. Raises CameraError while it does not stream."""
        self._phone = phone
        self._facts = phone.facts
        self._page = phone.page

    @property
    def facts(self) -> CameraFacts:
        """Properties and capabilities of this camera, with its current exposure."""
        return structs.replace(super().facts, exposure_ns=self._phone.exposure_ns)

    @property
    def device_clock(self) -> DeviceClock | None:
        """Accuracy of the clock of the phone's browser against the gateway's."""
        return self._phone.clock.accuracy

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Pass on the frames of the running stream. Raises CameraError if that stream has ended."""
        loop, clock, page = asyncio.get_running_loop(), self._phone.clock, self._phone.page
        if self._phone.facts != self.facts or page != self._page:
            raise CameraError(f"{self._phone.name} has returned as another camera")

        def deliver(frame: PhoneFrame) -> None:
            on_frame(
                CapturedFrame(
                    sequence=frame.sequence,
                    stream=frame.stream,
                    timestamp_ns=clock.gateway_ns(frame.page_us),
                    picture=PhonePicture(self._phone, page, frame.id, loop),
                    exposure_ns=self._phone.exposure_ns,
                    gain=self._phone.gain,
                    clock_uncertainty_ns=clock.uncertainty_ns(frame.page_us),
                )
            )

        def fail(why: str) -> None:
            self._phone.unwatch()
            on_failure(CameraError(f"{self._phone.name}: {why}"))

        self._phone.watch(deliver, fail)

    async def apply(self, command: CameraCommand) -> None:
        """Restart the stream after the command's delay; a time that has passed is moved by whole periods.

        Raises CameraError for any other command, or while the phone is not connected.
        """
        if not isinstance(command, RestartStream):
            raise CameraError("a phone in a browser cannot change the length of single frames")
        await self._phone.restart(command.delay_ns)

    async def controls(self) -> tuple[ControlState, ...]:
        """Return the controls that the phone's browser has, with their current values."""
        return self._phone.controls

    async def set_control(self, control: Control, value: float | None) -> None:
        """Set a control, which the page keeps through restarts. Raises CameraError if it cannot be set."""
        await self._phone.set_control(control, value)

    async def stop(self) -> None:
        """Stop passing frames on; the phone's camera keeps running. Calling it twice is harmless."""
        self._phone.unwatch()


class PhoneMicrophone:
    """The microphone of a phone, which its page opens with its camera."""

    def __init__(self, phone: Phone) -> None:
        """Take over a phone's microphone."""
        self._phone = phone

    def listen(self, on_sound: Callable[[bytes, int], None], closing: threading.Event) -> None:
        """Block and pass samples on until `closing` is set."""
        self._phone.on_sound = on_sound
        closing.wait()


class PhoneNodes:
    """Runs a node for each phone, in this process."""

    def __init__(
        self,
        leaders: tuple[Address, ...],
        spool: Path,
        talk: Callable[[str], None],
        *,
        sound: bool = False,
    ) -> None:
        """Create without nodes; `leaders` are tried in turn, `talk` gets messages for users.

        `sound`: images carry the phones' sound. Raises BadInputError if no plugin adds it.
        """
        self._leaders, self._spool, self._talk = leaders, spool, talk
        self._sound = load_plugin(COMMON_OPTIONS, "sound", "SoundCamera") if sound else None
        self._nodes = Background()

    def add(self, phone: Phone) -> None:
        """Run a node for a phone from now on."""
        self._nodes.start(self._look_after(phone))

    async def close(self) -> None:
        """End the nodes of all phones."""
        await self._nodes.end()

    def _open(self, phone: Phone) -> Camera:
        camera: Camera = PhoneCamera(phone)
        if self._sound is not None:
            camera = self._sound.SoundCamera(camera, PhoneMicrophone(phone), phone.name)
        return camera

    async def _look_after(self, phone: Phone) -> None:
        while True:
            await phone.came.wait()
            options = NodeOptions(
                name=phone.name,
                open_camera=lambda: self._open(phone),
                leaders=self._leaders,
                log=Log(lambda line: self._talk(f"{phone.name}: {line}"), name=phone.name),
                spool=self._spool,
                profiles=DeviceProfiles(),
                put_off=phone.put_off,
            )
            node = CameraNode(options)
            try:
                await first_of(node.run(), _until_disconnected(phone), _report_state(phone, node))
            except SimulshotError as error:
                self._talk(f"{phone.name}: {error}")
                await phone.report_state("failed", str(error))
                await asyncio.sleep(RETRY_S)
            else:
                self._talk(f"{phone.name}: it has left")


async def _until_disconnected(phone: Phone) -> None:
    """Return when the phone's user has left, or no page was connected for PAGE_CLOSED_S."""
    while True:
        await phone.closed.wait()
        if phone.said_goodbye or not await has_come(phone.back, PAGE_CLOSED_S):
            return


async def _report_state(phone: Phone, node: CameraNode) -> None:
    while True:
        await asyncio.sleep(REPORT_INTERVAL_S)
        phone.check_frames()
        state, words = node.standing
        # Sent even if unchanged: a page that was just loaded knows no state.
        await phone.report_state(str(state or "joining"), words)
