"""Cameras of Acme: grey images at a steady rate."""

import asyncio
import time
from collections.abc import Mapping

import numpy as np

from capture_app.cameras.base import Camera, OnFailure, OnFrame
from capture_app.cameras.frames import CapturedFrame, PixelPicture
from capture_app.cameras.specs import read_request
from capture_app.common.camera_facts import CameraFacts, CameraListing, PhaseControl, TimestampSource
from capture_app.common.clock import NodeClock
from capture_app.common.errors import CameraError
from capture_app.sync.wire.camera_commands import CameraCommand

SPEC = "acme:NUMBER[,fps=RATE]"
HELP = "Cameras of Acme."
NEEDS = ""
OPTIONS = {"fps": "frames a second (30)"}


class AcmeCamera(Camera):
    """A camera whose phase cannot be moved."""

    def __init__(self, number: str, fps: float) -> None:
        self._facts = CameraFacts(
            kind="acme",
            model=f"Acme {number}",
            width=64,
            height=48,
            period_ns=round(1e9 / fps),
            timestamp_source=TimestampSource.START_OF_EXPOSURE,
            phase_control=PhaseControl.NONE,
        )
        self._streaming: asyncio.Task[None] | None = None

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Start streaming."""
        self.listen(on_frame, on_failure)
        self._streaming = asyncio.create_task(self._stream())

    async def apply(self, command: CameraCommand) -> None:
        """Raise CameraError: no command is known."""
        raise CameraError("an Acme camera cannot be moved")

    async def stop(self) -> None:
        """Stop streaming."""
        if self._streaming is not None:
            self._streaming.cancel()

    async def _stream(self) -> None:
        pixels = np.full((self.facts.height, self.facts.width), 128, np.uint8)
        start_ns, sequence = time.monotonic_ns(), 0
        while True:
            picture = PixelPicture(pixels.nbytes, lambda width: pixels)
            stamp_ns = start_ns + sequence * self.facts.period_ns
            self._on_frame(CapturedFrame(sequence, 0, stamp_ns, picture))
            sequence += 1
            await asyncio.sleep((stamp_ns + self.facts.period_ns - time.monotonic_ns()) / 1e9)


def open_camera(number: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> Camera:
    """Open a camera by its number."""
    return AcmeCamera(number, read_request(options, "an Acme camera").fps or 30.0).in_clock(clock)


def list_cameras() -> list[CameraListing]:
    """Return the cameras of this machine."""
    return [CameraListing("acme:0", "acme", "Acme 0", "64x48")]
