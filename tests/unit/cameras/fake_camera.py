"""A camera that exists only in a test."""

import asyncio

import numpy as np
from numpy.typing import NDArray

from capture_app.cameras.base import Camera, OnFailure, OnFrame
from capture_app.cameras.frames import CapturedFrame
from capture_app.common.camera_facts import CameraFacts, PhaseControl
from capture_app.sync.wire.camera_commands import CameraCommand
from tests.facts import make_facts

PERIOD_NS = 33_333_333
FACTS = make_facts(period_ns=PERIOD_NS, phase_control=PhaseControl.RESET, exposure_ns=10_000_000)


class FakeCamera(Camera):
    """A camera whose frames and failures come from the test."""

    def __init__(self, facts: CameraFacts = FACTS) -> None:
        self._facts = facts
        self.on_frame: OnFrame
        self.on_failure: OnFailure
        self.commands: asyncio.Queue[CameraCommand] = asyncio.Queue()
        self.is_stopped = False

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        self.listen(on_frame, on_failure)
        self.on_frame, self.on_failure = self._on_frame, self._on_failure

    async def apply(self, command: CameraCommand) -> None:
        self.commands.put_nowait(command)

    async def stop(self) -> None:
        self.is_stopped = True


class NoPicture:
    """A picture that nobody looks at."""

    held_bytes = 0

    def encode(self) -> bytes:
        return b""

    def reduced(self, width: int) -> NDArray[np.uint8]:
        return np.zeros((1, width, 3), np.uint8)


def frame(stream: int, timestamp_ns: int = 0) -> CapturedFrame:
    return CapturedFrame(sequence=0, stream=stream, timestamp_ns=timestamp_ns, picture=NoPicture())
