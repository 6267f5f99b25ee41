"""Supervision of a node's camera: keeps it streaming into the engine, reopens it, and sets its controls.

Automatic controls are locked while a burst is captured, so that its frames are consistent. That is done only
where the driver is seen to report the camera's choices: a control that always reads the same may report
nothing, and locking it would change the image.
"""

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from msgspec.structs import replace

from capture_app.cameras.base import Camera
from capture_app.cameras.frames import CapturedFrame
from capture_app.common import host_clock
from capture_app.common.address import Address
from capture_app.common.camera_facts import (
    CameraControls,
    Control,
    ControlState,
    ControlValue,
    StampAccuracy,
)
from capture_app.common.errors import CameraError, SimulshotError
from capture_app.common.tasks import has_come
from capture_app.net.udp import Pump
from capture_app.node.camera.device_profiles import NO_PROFILES, DeviceProfiles, camera_key
from capture_app.node.endpoint import EndpointOptions
from capture_app.sync.phase.estimator import FrameStamp
from capture_app.sync.rig.client import Client
from capture_app.sync.rig.frame_selection import RING_BYTES, RING_NS
from capture_app.sync.wire.camera_commands import CameraCommand, RestartStream

REFUSALS = (SimulshotError, OSError)
"""Errors that a camera may raise when its controls are read or set."""
LOOK_EVERY_S = 2.0
"""Interval between reads of the values that the camera has chosen."""
RETRY_S = 2.0
SILENCE_TICK_S, SILENT_TICKS, SILENT_PERIODS = 1.0, 10, 30
"""A camera has failed without a frame for so many ticks in a row, each of this length or of so many periods.

Ticks, as a process that was suspended has heard nothing meanwhile.
"""


class ControlKeeper:
    """Controls of one camera: set by operators, and locked during bursts."""

    def __init__(self, camera: "CameraSupervisor") -> None:
        self.latest: tuple[ControlState, ...] = ()
        """All controls at the last read."""
        self._supervisor = camera
        self._busy = asyncio.Lock()
        self.held: dict[Control, float] = {}
        """Values that an operator has set."""
        self._seen: dict[Control, float | None] = {}
        self._live: set[Control] = set()
        """Controls whose driver reports what the camera chooses."""
        self._locked: set[Control] = set()
        self._in_burst = False
        self._burst_changed = asyncio.Event()

    def set_in_burst(self, in_burst: bool) -> None:
        """Note whether frames of a burst are being captured."""
        if in_burst != self._in_burst:
            self._in_burst = in_burst
            self._burst_changed.set()

    async def run(self) -> None:
        """Track what the camera chooses and lock it for bursts, until cancelled; then unlock it."""
        try:
            while True:
                await has_come(self._burst_changed, LOOK_EVERY_S)
                self._burst_changed.clear()
                with suppress(*REFUSALS):
                    async with self._busy:
                        await (self._lock() if self._in_burst else self._unlock())
        finally:
            # A camera may keep its last setting, for other programs too.
            await self._let_go()

    async def read(self) -> CameraControls:
        """Return the current state of all controls."""
        async with self._busy:
            return CameraControls(controls=await self._look())

    async def apply(self, values: Mapping[Control, ControlValue]) -> CameraControls:
        """Set these controls as far as possible; return the resulting state of all, and any problems."""
        problems: dict[Control, str] = {}
        async with self._busy:
            before = CameraControls(controls=await self._look())
            for control, value in values.items():
                state = before.state(control)
                try:
                    problem = (
                        await self._set(state, value) if state else f"its {control} cannot be controlled"
                    )
                except REFUSALS as error:
                    problem = str(error)
                if problem:
                    problems[control] = problem
            self._supervisor.note_exposure()
            return CameraControls(controls=await self._look(), problems=problems)

    async def restore(self) -> None:
        """Set held controls again, after the camera was reopened."""
        async with self._busy:
            for control, value in self.held.items():
                with suppress(*REFUSALS):
                    await self._supervisor.camera.set_control(control, value)
            if self.held:
                self._supervisor.note_exposure()

    async def _look(self) -> tuple[ControlState, ...]:
        self.latest = ()
        # Others reopen a camera that has failed, and an error of its controls does not end the node.
        with suppress(*REFUSALS):
            self.latest = await self._supervisor.camera.controls()
        return self.latest

    async def _set(self, state: ControlState, value: ControlValue) -> str:
        """Set one control; return how the camera's setting differs from the request, empty if it does not."""
        if value == "auto" and not state.can_be_automatic:
            return f"it has no automatic {state.control}"
        if value == "auto":
            self.held.pop(state.control, None)
            self._locked.discard(state.control)
            await self._supervisor.camera.set_control(state.control, None)
            return ""
        control, asked = state.control, state.value if isinstance(value, str) else value
        if not state.can_be_set:
            return f"its {control} cannot be set"
        if asked is None:
            return f"it does not report its {control}, so that cannot be locked"
        nearest = state.clamped(asked)
        await self._supervisor.camera.set_control(control, nearest)
        self.held[control] = nearest
        self._locked.discard(control)
        if value == "hold" and state.automatic and control not in self._live:
            return f"it may report another {control} than it used: check whether the picture has changed"
        if nearest != asked:
            return f"{asked:g} {state.unit} is out of its range, {state.minimum:g} to {state.maximum:g}"
        return ""

    # The engine does not learn of locks for a burst. An exposure that becomes known shifts the moment of
    # exposure that timestamps are taken for, and with it the grid, just while a burst is captured.

    async def _lock(self) -> None:
        for state in await self._look():
            if state.automatic and state.control in self._live and state.value is not None:
                self._locked.add(state.control)
                await self._supervisor.camera.set_control(state.control, state.value)

    async def _unlock(self) -> None:
        await self._let_go()
        for state in await self._look():
            if state.automatic and state.control in self._seen and self._seen[state.control] != state.value:
                self._live.add(state.control)
            self._seen[state.control] = state.value

    async def _let_go(self) -> None:
        """Return locked controls to automatic; one that the camera refuses stays locked for now."""
        for control in tuple(self._locked):
            with suppress(*REFUSALS):
                await self._supervisor.camera.set_control(control, None)
                self._locked.discard(control)


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeOptions(EndpointOptions):
    """Options that a node is started with."""

    name: str
    label: str = ""
    """What its owner calls the camera, in any script; empty if that is its name."""
    open_camera: Callable[[], Camera]
    """Called at the start, and again after each failure of the device."""
    leaders: tuple[Address, ...]
    """Leaders or relays of one rig, tried in turn."""
    tolerance_ns: int | None = None
    """Phase errors up to this are left alone; None for the default of the camera's kind."""
    clock_tolerance_ns: int | None = None
    """Clock accuracy that is required to be ready; None for what the link can bear."""
    ring_ns: int = RING_NS
    """Maximum age of frames stored for bursts in the past."""
    ring_bytes: int = RING_BYTES
    """Maximum memory for stored frames, and again for frames that are not on a disk yet."""
    moves_in_recordings: bool = False
    """Whether a recorded stream that drifts is brought back by one longer frame."""
    spool: Path | None = None
    """Folder for the images that the leader does not have yet; without one they stay in memory."""
    profiles: DeviceProfiles = NO_PROFILES
    """Stored device profiles; updated with new measurements."""
    put_off: Callable[[], None] = lambda: None
    """Called when an operator removes the camera from the rig."""


class CameraSupervisor:
    """A node's camera, across all reopenings of the device; it begins with `open`.

    Each receiver gets each frame in order. Frames that arrive before there is a receiver are dropped.
    """

    def __init__(self, options: NodeOptions, *, retry_s: float = RETRY_S) -> None:
        """A failed camera is reopened every `retry_s`."""
        self._options, self._retry_s = options, retry_s
        self.measured_stamp: StampAccuracy | None = None
        """Timestamp accuracy measured in this run, for `update_facts`."""
        self.receivers: list[Callable[[CapturedFrame], None]] = []
        self._slept_ns = host_clock.slept_ns()
        self._commands: asyncio.Queue[tuple[CameraCommand, int]] = asyncio.Queue()
        """Commands, each with the local time in ns at which the engine computed it."""
        self._engine_ns = 0
        self.controls = ControlKeeper(self)
        """Exposure, gain, white balance and focus."""
        self._streams_before = self._last_stream = self._delivered = 0
        self._arrived: list[tuple[FrameStamp, CapturedFrame, int]] = []
        """Frames that the engine has not got yet, with their memory in bytes."""

    async def open(self) -> None:
        """Open the camera, again after a failure, and start its stream. Raises the camera's errors."""
        self.camera: Camera = self._options.open_camera()
        """The open camera."""
        self._started_ns = self._options.clock.now_ns()
        """Time of the start command, in ns of the node's clock."""
        failed: asyncio.Future[Exception] = asyncio.get_running_loop().create_future()
        self._failed = failed
        """The error of the device once it has failed."""

        def on_failure(error: Exception) -> None:
            if not failed.done():
                failed.set_result(error)

        try:
            await self.camera.start(self._deliver, on_failure)
            self.update_facts()
        except BaseException:
            # A device that stays open cannot be opened again.
            await self.camera.stop()
            raise

    def update_facts(self) -> None:
        """Read the camera's facts and timestamp accuracy, as the leader and sessions get them."""
        facts = self.camera.facts
        reported, measured = facts.stamp_accuracy, self.measured_stamp
        if measured is None or measured.exposure_ns != facts.exposure_ns:
            measured = (
                None
                if reported.is_exact
                else self._options.profiles.read(camera_key(self._options.name, facts)).stamp
            )
        self.facts = replace(facts, stamp=measured or reported, label=self._options.label or facts.label)

    def _deliver(self, frame: CapturedFrame) -> None:
        self._delivered += 1
        for receive in self.receivers:
            receive(frame)

    def connect(self, engine: Client[CapturedFrame], pump: Pump) -> None:
        """Pass frames to an engine, which `pump` runs, and its commands to the camera."""
        self._engine, self._pump = engine, pump
        engine.stream_started(self._started_ns)
        self.receivers.append(self.add_frame)

    def notice_sleep(self) -> None:
        """Tell the engine if the machine has slept since the last call."""
        before_ns, self._slept_ns = self._slept_ns, host_clock.slept_ns()
        if self._slept_ns > before_ns:
            self._engine.wake_up(self._slept_ns - before_ns, self._options.clock.now_ns())

    def collect_commands(self) -> None:
        """Queue the engine's commands for the camera, and lock its controls while a burst is captured."""
        self.controls.set_in_burst(self._engine.has_burst_pending)
        while (command := self._engine.next_command()) is not None:
            self._commands.put_nowait((command, self._engine_ns))

    async def keep_open(self) -> None:
        """Wait for the device to fail and reopen it, forever.

        Raises CameraError if another camera is connected then.
        """
        while True:
            error = await self._next_failure()
            self._options.log.say(f"camera failed: {error}")
            self._report_to_engine(str(error))
            await self.camera.stop()
            await self._reopen()
            await self.controls.restore()
            self._options.log.say("camera is back")
            self._report_to_engine("")

    async def _next_failure(self) -> Exception:
        """Wait until the device fails, or delivers nothing any more though its driver has seen no error."""
        delivered, ticks = -1, 0
        while ticks < SILENT_TICKS:
            periods_s = SILENT_PERIODS / SILENT_TICKS * self.facts.period_ns * 1e-9
            await asyncio.wait((self._failed,), timeout=max(SILENCE_TICK_S, periods_s))
            if self._failed.done():
                return self._failed.result()
            ticks = ticks + 1 if self._delivered == delivered else 0
            delivered = self._delivered
        return CameraError("it delivers no frames any more", hint="check its cable")

    async def carry_out_commands(self) -> None:
        """Apply the queued commands in order, forever."""
        while True:
            command, reckoned_ns = await self._commands.get()
            given_ns = self._options.clock.now_ns()
            if isinstance(command, RestartStream):
                delay_ns = command.delay_ns - (given_ns - reckoned_ns)
                # Too late for the targeted start: the same phase in a later period is as good.
                command = RestartStream(delay_ns if delay_ns >= 0 else delay_ns % self.facts.period_ns)
            try:
                await self.camera.apply(command)
            except CameraError as error:
                self._options.log.say(f"camera refused a command: {error}")
            else:
                if isinstance(command, RestartStream):
                    # Cameras keep to this moment, or to whole periods after it, whatever this loop's delay.
                    self._engine.stream_started(given_ns + command.delay_ns)

    async def _reopen(self) -> None:
        before = self.facts
        self._streams_before = self._last_stream + 1
        while True:
            await asyncio.sleep(self._retry_s)
            try:
                await self.open()
                break
            except SimulshotError as reason:
                self._report_to_engine(str(reason))
        # A camera that was unplugged forgets its exposure; it is still the same camera.
        if replace(self.facts, exposure_ns=before.exposure_ns, stamp=before.stamp) != before:
            raise CameraError(
                f"another camera is connected now: {self.facts.model}", hint="start the node again"
            )
        self._engine.stream_started(self._started_ns)

    def note_exposure(self) -> None:
        """Notify the engine if the camera's exposure or timestamp accuracy has changed."""
        before = self.facts
        self.update_facts()
        if self.facts != before:
            self._engine.update_camera(self.facts)
            self._pump.turn()

    def add_frame(self, frame: CapturedFrame) -> None:
        """Pass the next frame to the engine, together with those that arrive at the same time."""
        # A reopened camera counts its streams from the start; the engine's count goes on.
        self._last_stream = self._streams_before + frame.stream
        stamp = FrameStamp(frame.sequence, self._last_stream, frame.timestamp_ns)
        if not self._arrived:
            asyncio.get_running_loop().call_soon(self._pass_on)
        self._arrived.append((stamp, frame, frame.picture.held_bytes))

    def _pass_on(self) -> None:
        self.notice_sleep()
        self._engine_ns = self._options.clock.now_ns()
        arrived, self._arrived = self._arrived, []
        self._engine.frames_arrived(arrived, self._engine_ns)
        self._pump.turn()

    def _report_to_engine(self, failure: str) -> None:
        self._engine.fail(failure)
        self._pump.turn()
