"""A node's camera kept streaming into its engine: opened again when it fails, its commands carried out."""

import asyncio
from collections.abc import Callable

from msgspec.structs import replace

from capture_app.camera_facts import CameraFacts, StampAccuracy
from capture_app.cameras.base import Camera, CapturedFrame, DeviceClock
from capture_app.clock import NodeClock
from capture_app.errors import CameraError, SimulshotError
from capture_app.node.camera.control_keeper import ControlKeeper
from capture_app.session.format.calibration import CameraCalibration
from capture_app.sync.rig.client import Client
from capture_app.sync.stamps.frame_stamp import FrameStamp
from capture_app.sync.wire.camera_commands import CameraCommand, RestartStream

RETRY_S = 2.0


class CameraSupervisor:
    """Streams one camera into an engine, over as many failures of the device as there are."""

    def __init__(
        self,
        open_camera: Callable[[], Camera],
        clock: NodeClock,
        talk: Callable[[str], None],
        *,
        retry_s: float = RETRY_S,
        measured_stamp: Callable[[CameraFacts], StampAccuracy | None] = lambda _: None,
    ) -> None:
        """`open_camera` is called again after each failure, each `retry_s`.

        `measured_stamp` tells how late the stamps of the camera were measured to be, None where nobody has.
        """
        self._measured_stamp = measured_stamp
        self._set_stamp: StampAccuracy | None = None
        self._open_camera = open_camera
        self._clock = clock
        self._talk = talk
        self._retry_s = retry_s
        self._camera: Camera
        self._facts: CameraFacts
        self._failed: asyncio.Future[Exception]
        self._started_ns = 0
        self._engine: Client[CapturedFrame] | None = None
        self._after_turn: Callable[[], None] = lambda: None
        self._on_frame: Callable[[CapturedFrame], None] = lambda _: None
        self._commands: asyncio.Queue[tuple[CameraCommand, int]] = asyncio.Queue()
        """Each with the local time in ns that the engine reckoned with."""
        self._engine_ns = 0
        self.controls = ControlKeeper(lambda: self._camera, self._note_exposure)
        """Exposure, gain, white balance and focus."""
        self._streams_before = self._last_stream = 0

    @property
    def facts(self) -> CameraFacts:
        """What the camera is and can do."""
        return self._facts

    @property
    def calibration(self) -> CameraCalibration | None:
        """The camera's own calibration, where it is known."""
        return self._camera.calibration

    @property
    def device_clock(self) -> DeviceClock | None:
        """The clock that the camera stamps by, where that is one of its own."""
        return self._camera.device_clock

    async def start(self) -> None:
        """Open the camera and start its stream. Raises what the camera raises."""
        self._camera = self._open_camera()
        self._started_ns = self._clock.now_ns()
        self._failed = asyncio.get_running_loop().create_future()
        failed = self._failed

        def on_failure(error: Exception) -> None:
            if not failed.done():
                failed.set_result(error)

        # A camera that was opened again counts its streams from the start; the engine's count goes on.
        self._streams_before = self._last_stream + 1
        await self._camera.start(self._deliver, on_failure)
        self._facts = self._said_facts()

    def set_stamp(self, stamp: StampAccuracy) -> None:
        """Go by what was measured just now of how late the camera's stamps are."""
        self._set_stamp = stamp
        self._note_exposure()

    async def stop(self) -> None:
        """Stop the stream and let go of the camera."""
        await self._camera.stop()

    def attach(
        self,
        engine: Client[CapturedFrame],
        after_turn: Callable[[], None],
        on_frame: Callable[[CapturedFrame], None] = lambda _: None,
    ) -> None:
        """Give the engine all frames from now on, and then `on_frame`.

        `after_turn` is called whenever the engine may have news.
        """
        self._engine, self._after_turn, self._on_frame = engine, after_turn, on_frame
        engine.stream_started(self._started_ns)

    def collect_commands(self) -> None:
        """Queue what the engine asks of the camera, and hold its controls while frames of a burst come."""
        if self._engine is not None:
            self.controls.set_in_burst(self._engine.has_burst_pending)
        while self._engine is not None and (command := self._engine.next_command()) is not None:
            self._commands.put_nowait((command, self._engine_ns))

    async def keep_open(self) -> None:
        """Wait for the device to fail, and then try to open it again and again, for ever.

        Raises CameraError where another camera is there then.
        """
        while True:
            error = await self._failed
            self._talk(f"camera failed: {error}")
            self._tell_engine(str(error))
            await self._camera.stop()
            await self._reopen()
            await self.controls.restore()
            self._talk("camera is back")
            self._tell_engine("")

    async def carry_out_commands(self) -> None:
        """Apply the queued commands in their order, for ever."""
        while True:
            command, reckoned_ns = await self._commands.get()
            given_ns = self._clock.now_ns()
            if isinstance(command, RestartStream):
                delay_ns = command.delay_ns - (given_ns - reckoned_ns)
                # Too late for the start aimed at: the same place in a later period is as good.
                command = RestartStream(delay_ns if delay_ns >= 0 else delay_ns % self._facts.period_ns)
            try:
                await self._camera.apply(command)
            except CameraError as error:
                self._talk(f"camera refused a command: {error}")
                continue
            if isinstance(command, RestartStream) and self._engine is not None:
                # Cameras keep to this moment, or to whole periods after it, however late this loop is.
                self._engine.stream_started(given_ns + command.delay_ns)

    async def _reopen(self) -> None:
        before = self._facts
        while True:
            await asyncio.sleep(self._retry_s)
            try:
                await self.start()
                break
            except SimulshotError as reason:
                await self._camera.stop()
                self._tell_engine(str(reason))
        # A camera that was unplugged forgets its exposure; that makes it no other camera.
        if replace(self._facts, exposure_ns=before.exposure_ns, stamp=before.stamp) != before:
            raise CameraError(
                f"another camera is connected now: {self._facts.model}", hint="start the node again"
            )
        if self._engine is not None:
            self._engine.stream_started(self._started_ns)

    def _said_facts(self) -> CameraFacts:
        """What the camera is, and what is known of its stamps, as the leader and sessions are told."""
        facts = self._camera.facts
        told, just_set = facts.stamp_accuracy, self._set_stamp
        if just_set is not None and just_set.exposure_ns == facts.exposure_ns:
            return replace(facts, stamp=just_set)
        measured = None if told.is_exact else self._measured_stamp(facts)
        return replace(facts, stamp=measured or told)

    def _note_exposure(self) -> None:
        if (facts := self._said_facts()) != self._facts and self._engine is not None:
            self._facts = facts
            self._engine.update_camera(facts)

    def _tell_engine(self, failure: str) -> None:
        if self._engine is not None:
            self._engine.fail(failure)
            self._after_turn()

    def _deliver(self, frame: CapturedFrame) -> None:
        if self._engine is None:
            return
        self._last_stream = self._streams_before + frame.stream
        stamp = FrameStamp(frame.sequence, self._last_stream, frame.timestamp_ns)
        self._engine_ns = self._clock.now_ns()
        self._engine.frame_arrived(stamp, frame, self._engine_ns)
        self._after_turn()
        self._on_frame(frame)
