"""A camera's stream while it is measured: its frames on a line, what it drops, how late it delivers."""

import asyncio
from collections import deque
from collections.abc import Callable
from statistics import fmean, median

from capture_app.cameras.base import Camera, CapturedFrame
from capture_app.clock import NodeClock
from capture_app.errors import CameraError
from capture_app.sync.phase.estimator import PhaseEstimator
from capture_app.sync.phase.stamps import FrameStamp
from capture_app.sync.wire.camera_commands import CameraCommand, RestartStream

PATIENCE_S = 15.0
"""A camera without frames for so long gives none."""
PLACE_FRAMES = 40
"""Frames that tell the phase, before and after a move."""
OUTLIER = 4.0
"""A stamp so many times as far off as others usually are does not count."""


class StreamWatch:
    """One opened camera, from its start to its stop; times in ns of the clock that it is stamped in."""

    def __init__(self, camera: Camera, clock: NodeClock) -> None:
        self.camera = camera
        self.phase = PhaseEstimator(period_ns=camera.facts.period_ns)
        self.deliveries_ns: list[int] = []
        """From each frame's stamp to its arrival here."""
        self.exposure_ns: int | None = None
        """Of the newest frame."""
        self._clock = clock
        self._arrived = asyncio.Event()
        self._failure: Exception | None = None
        self._stream = -1
        self._first_stamp_ns = 0
        self._stamps: deque[tuple[int, int]] = deque(maxlen=PLACE_FRAMES)
        """The newest frames' numbers and stamps."""

    async def start(self) -> int:
        """Start the stream; return the time from the command to the first frame's stamp.

        Raises CameraError where the camera cannot start or gives no frames.
        """
        begun_ns = self._clock.now_ns()
        await self.camera.start(self._add, self._fail)
        await self.frames(1)
        return self._first_stamp_ns - begun_ns

    async def restart(self, delay_ns: int) -> int:
        """Restart the stream; return the time from the command to its first frame's stamp."""
        stream, begun_ns = self._stream, self._clock.now_ns() + delay_ns
        await self.camera.apply(RestartStream(delay_ns))
        await self.until(lambda: self._stream > stream)
        return self._first_stamp_ns - begun_ns

    async def shift(self, command: CameraCommand) -> tuple[float, int | None]:
        """Give a command; return how far it moved the phase, and the frames until it had, None for never.

        The phase is known by PLACE_FRAMES before, and as many after: their stamps have been seen before it.
        """
        phase, sequence = self.phase, self._stamps[-1][0]
        before_ns = self._place(sequence)
        phase.mark_disturbance()
        await self.camera.apply(command)
        await self.until(lambda: not phase.disturbed)
        moved = phase.last_shift_ns is not None
        await self.frames(PLACE_FRAMES)
        return self._place(sequence) - before_ns, phase.last_latency_frames if moved else None

    def _place(self, sequence: int) -> float:
        """When the frame of that number would have come by the newest frames, outliers aside."""
        period_ns = self.phase.period_ns
        places = [stamp_ns - period_ns * (number - sequence) for number, stamp_ns in self._stamps]
        middle, noise_ns = median(places), max(self.phase.noise_ns, 1_000.0)
        return fmean(place for place in places if abs(place - middle) <= OUTLIER * noise_ns)

    async def frames(self, count: int) -> None:
        """Wait for so many more frames."""
        wanted = self.phase.frames + count
        await self.until(lambda: self.phase.frames >= wanted)

    async def until(self, holds: Callable[[], bool]) -> None:
        """Wait until something holds that frames bring about. Raises CameraError where none come."""
        while not holds():
            self._arrived.clear()
            try:
                async with asyncio.timeout(PATIENCE_S):
                    await self._arrived.wait()
            except TimeoutError:
                raise CameraError(f"the camera gave no frames for {PATIENCE_S:.0f} s") from None
            if self._failure is not None:
                raise CameraError(f"the camera failed: {self._failure}")

    def _add(self, frame: CapturedFrame) -> None:
        self.deliveries_ns.append(self._clock.now_ns() - frame.timestamp_ns)
        if frame.stream > self._stream:
            self._stream, self._first_stamp_ns = frame.stream, frame.timestamp_ns
        self._stamps.append((frame.sequence, frame.timestamp_ns))
        self.exposure_ns = frame.exposure_ns
        self.phase.add(FrameStamp(frame.sequence, frame.stream, frame.timestamp_ns))
        self._arrived.set()

    def _fail(self, error: Exception) -> None:
        self._failure = error
        self._arrived.set()
