"""A node's camera kept streaming into its engine: opened again when it fails, its commands carried out.

Keeps the controls of a node's camera: sets what is asked for, again after a failure, and locks for bursts.

What a camera chooses by itself is locked while a burst is picked, so that its frames look alike. That is done
where its driver is seen to tell what it chooses: a control that reads the same for ever may tell nothing, and
to hold it would change the picture.
"""

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress

from msgspec.structs import replace

from capture_app.camera_facts import (
    CameraControls,
    CameraFacts,
    Control,
    ControlState,
    ControlValue,
    StampAccuracy,
)
from capture_app.cameras.base import Camera, CapturedFrame, DeviceClock
from capture_app.clock import NodeClock
from capture_app.errors import CameraError, SimulshotError
from capture_app.session.format.calibration import CameraCalibration
from capture_app.sync.phase.stamps import FrameStamp
from capture_app.sync.rig.client import Client
from capture_app.sync.wire.camera_commands import CameraCommand, RestartStream

REFUSALS = (SimulshotError, OSError)
"""What a camera may raise that is asked for its controls."""
LOOK_EVERY_S = 2.0
"""Between two looks at what the camera has chosen."""


class ControlKeeper:
    """One camera's."""

    def __init__(self, camera: Callable[[], Camera], after_change: Callable[[], None]) -> None:
        """`camera` returns the one that is open; `after_change` is called when it may expose otherwise."""
        self.latest: tuple[ControlState, ...] = ()
        """All controls, as they were when they were looked at last."""
        self._camera, self._after_change = camera, after_change
        self._busy = asyncio.Lock()
        self._wanted: dict[Control, float] = {}
        """What is held because somebody asked for it."""
        self._seen: dict[Control, float | None] = {}
        self._live: set[Control] = set()
        """Those whose driver tells what the camera chooses."""
        self._locked: set[Control] = set()
        self._in_burst = False
        self._burst_changed = asyncio.Event()

    def set_in_burst(self, in_burst: bool) -> None:
        """Note that frames of a burst are being picked, or none are any more."""
        if in_burst != self._in_burst:
            self._in_burst = in_burst
            self._burst_changed.set()

    async def run(self) -> None:
        """Look at what the camera chooses, and lock it for bursts, until cancelled; then it is as it was."""
        try:
            while True:
                with suppress(TimeoutError):
                    async with asyncio.timeout(LOOK_EVERY_S):
                        await self._burst_changed.wait()
                self._burst_changed.clear()
                with suppress(*REFUSALS):
                    async with self._busy:
                        await (self._lock() if self._in_burst else self._unlock())
        finally:
            # A camera may keep what it was told last, for other programs too.
            await self._let_go()

    async def read(self) -> CameraControls:
        """Return all controls as they stand."""
        async with self._busy:
            return CameraControls(controls=await self._look())

    async def apply(self, wanted: Mapping[Control, ControlValue]) -> CameraControls:
        """Set these controls as well as the camera can; return all as they stand then, and what it cannot."""
        problems: dict[Control, str] = {}
        async with self._busy:
            before = CameraControls(controls=await self._look())
            for control, value in wanted.items():
                state = before.state(control)
                if state is None:
                    problems[control] = f"it has no control of its {control}"
                    continue
                try:
                    if problem := await self._set(state, value):
                        problems[control] = problem
                except REFUSALS as error:
                    problems[control] = str(error)
            self._after_change()
            return CameraControls(controls=await self._look(), problems=problems)

    async def restore(self) -> None:
        """Set again what is held, and let go of what was locked: the camera was opened anew."""
        async with self._busy:
            await self._let_go()
            for control, value in self._wanted.items():
                with suppress(*REFUSALS):
                    await self._camera().set_control(control, value)
            if self._wanted:
                self._after_change()

    async def _look(self) -> tuple[ControlState, ...]:
        self.latest = ()
        # A camera that has failed is opened again by others, and none of its controls ends the node.
        with suppress(*REFUSALS):
            self.latest = await self._camera().controls()
        return self.latest

    async def _set(self, state: ControlState, value: ControlValue) -> str:
        """Set one; return what is not as it was asked for, empty where nothing is."""
        if value == "auto":
            return await self._release(state)
        control, asked = state.control, state.value if isinstance(value, str) else value
        if not state.can_be_set:
            return f"its {control} cannot be set"
        if asked is None:
            return f"it does not tell its {control}, which is not held"
        nearest = state.clamped(asked)
        await self._camera().set_control(control, nearest)
        self._wanted[control] = nearest
        self._locked.discard(control)
        if value == "hold" and state.automatic and control not in self._live:
            return f"it may not tell the {control} that it had chosen: look whether the picture has changed"
        if nearest != asked:
            return f"{asked:g} {state.unit} is out of its range, {state.least:g} to {state.most:g}"
        return ""

    async def _release(self, state: ControlState) -> str:
        if not state.can_be_automatic:
            return f"it does not choose its {state.control} itself"
        self._wanted.pop(state.control, None)
        self._locked.discard(state.control)
        await self._camera().set_control(state.control, None)
        return ""

    # What is locked for a burst is not told to the engine: an exposure that becomes known moves the moment of
    # light that stamps are taken for, and with it the grid, just when a burst is picked.

    async def _lock(self) -> None:
        for state in await self._look():
            if state.automatic and state.control in self._live and state.value is not None:
                self._locked.add(state.control)
                await self._camera().set_control(state.control, state.value)

    async def _unlock(self) -> None:
        await self._let_go()
        for state in await self._look():
            if state.automatic and state.control in self._seen and self._seen[state.control] != state.value:
                self._live.add(state.control)
            self._seen[state.control] = state.value

    async def _let_go(self) -> None:
        """Have the camera choose again what is locked; what it refuses stays locked, until the next time."""
        for control in tuple(self._locked):
            with suppress(*REFUSALS):
                await self._camera().set_control(control, None)
                self._locked.discard(control)


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
