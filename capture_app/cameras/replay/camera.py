"""A recording as a live camera: its frames delivered at the times they were taken at, again and again."""

import asyncio
import time
from collections.abc import Callable

from capture_app.camera_facts import CameraFacts, PhaseControl
from capture_app.cameras.base import Camera, CapturedFrame, OnFailure, OnFrame
from capture_app.cameras.replay.recordings import Recording
from capture_app.cameras.replay.timing import Playback
from capture_app.errors import CameraError, SimulshotError
from capture_app.session.format.calibration import CameraCalibration
from capture_app.sync.wire.camera_commands import CameraCommand, InjectFrame, RestartStream

DELIVERY_NS = 3_000_000
"""From the end of a frame's readout to its callback, as drivers take."""
STALL_NS = 500_000_000
"""A driver has few buffers: frames that are not fetched for this long are dropped."""


class ReplayCamera(Camera):
    """Plays a recording in the host's monotonic clock; a task waits for each frame's time."""

    def __init__(self, recording: Recording, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        """`now_ns` reads the host's monotonic clock."""
        self._recording = recording
        self._now_ns = now_ns
        self._playback = Playback(
            recording.timing, anchored=recording.facts.phase_control is PhaseControl.NONE
        )
        self._playing: asyncio.Task[None] | None = None
        self._on_frame: OnFrame
        self._on_failure: OnFailure

    @property
    def facts(self) -> CameraFacts:
        """Those of the recorded camera, as far as they are known."""
        return self._recording.facts

    @property
    def calibration(self) -> CameraCalibration | None:
        """That of the recording."""
        return self._recording.calibration

    async def start(self, on_frame: OnFrame, on_failure: OnFailure) -> None:
        """Start playing. Raises CameraError if it plays already."""
        if self._playing is not None:
            raise CameraError(f"the replay of {self.facts.model} was started already")
        self._on_frame, self._on_failure = on_frame, on_failure
        self._play_from(self._now_ns())

    async def apply(self, command: CameraCommand) -> None:
        """Let the next frame last longer or shorter, or begin a new stream; its delay counts from this call.

        Raises CameraError where it does not play, and for what no recording can do.
        """
        asked_ns = self._now_ns()
        if self._playing is None:
            raise CameraError(f"the replay of {self.facts.model} does not run")
        if self.facts.phase_control is PhaseControl.NONE or isinstance(command, InjectFrame):
            raise CameraError(f"the replay of {self.facts.model} cannot do that")
        if isinstance(command, RestartStream):
            await self._halt()
            self._play_from(asked_ns + command.delay_ns)
            await asyncio.sleep(command.delay_ns / 1e9)
        else:
            self._playback.lengthen_frame(command.duration_ns)

    async def stop(self) -> None:
        """Stop playing. Calling it twice is harmless."""
        await self._halt()

    async def _halt(self) -> None:
        playing, self._playing = self._playing, None
        if playing is not None:
            playing.cancel()
            await asyncio.wait((playing,))

    def _play_from(self, start_ns: int) -> None:
        self._playback.start(start_ns)
        self._playing = asyncio.create_task(self._play())

    async def _play(self) -> None:
        loop, recording = asyncio.get_running_loop(), self._recording
        readout_ns = (self.facts.row_time_ns or 0) * (self.facts.height - 1)
        while True:
            frame = self._playback.next_frame()
            settings = recording.settings(frame.index)
            due_ns = frame.start_ns + (settings.exposure_ns or 0) + readout_ns + DELIVERY_NS
            if self._now_ns() - due_ns > STALL_NS:
                await asyncio.sleep(0)
                continue
            try:
                picture = await loop.run_in_executor(None, recording.picture, frame.index)
            except (OSError, SimulshotError) as error:
                self._on_failure(CameraError(f"the replay of {self.facts.model} cannot go on: {error}"))
                return
            await asyncio.sleep(max(0, due_ns - self._now_ns()) / 1e9)
            if picture is None:
                continue  # its number is missing from the stream: a dropped frame like any other
            self._on_frame(
                CapturedFrame(
                    sequence=frame.sequence,
                    stream=frame.stream,
                    timestamp_ns=frame.start_ns + settings.stamp_error_ns,
                    picture=picture,
                    exposure_ns=settings.exposure_ns,
                    gain=settings.gain,
                    white_balance=settings.white_balance,
                )
            )
