"""A node's camera kept streaming into its engine: opened again when it fails, told what it is asked for.

What a camera chooses by itself is locked while a burst is picked, so that its frames look alike. That is done
where its driver is seen to tell what it chooses: a control that reads the same for ever may tell nothing, and
to hold it would change the picture.
"""

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, Self

from msgspec.structs import replace

from capture_app.cameras.base import Camera
from capture_app.cameras.frames import CapturedFrame
from capture_app.common.address import Address
from capture_app.common.camera_facts import (
    CameraControls,
    CameraFacts,
    Control,
    ControlState,
    ControlValue,
    StampAccuracy,
)
from capture_app.common.clock import HostClock, NodeClock
from capture_app.common.errors import CameraError, SimulshotError
from capture_app.common.tasks import has_come
from capture_app.net.udp import Pump
from capture_app.node.camera.device_profiles import DeviceProfiles
from capture_app.protocol.news import Log
from capture_app.sync.phase.estimator import FrameStamp
from capture_app.sync.rig.client import Client
from capture_app.sync.rig.frame_selection import RING_BYTES, RING_NS
from capture_app.sync.wire.camera_commands import CameraCommand, RestartStream
from capture_app.trust.trust import Trust

REFUSALS = (SimulshotError, OSError)
"""What a camera may raise that is asked for its controls."""
LOOK_EVERY_S = 2.0
"""Between two looks at what the camera has chosen."""
RETRY_S = 2.0


class ControlKeeper:
    """One camera's."""

    def __init__(self, camera: "CameraSupervisor") -> None:
        self.latest: tuple[ControlState, ...] = ()
        """All controls, as they were when they were looked at last."""
        self._supervisor = camera
        self._busy = asyncio.Lock()
        self.held: dict[Control, float] = {}
        """What is held because somebody asked for it."""
        self._seen: dict[Control, float | None] = {}
        self._live: set[Control] = set()
        """Controls whose driver tells what the camera chooses."""
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
                await has_come(self._burst_changed, LOOK_EVERY_S)
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
            self._supervisor.note_exposure()
            return CameraControls(controls=await self._look(), problems=problems)

    async def restore(self) -> None:
        """Set again what is held, and let go of what was locked: the camera was opened anew."""
        async with self._busy:
            await self._let_go()
            for control, value in self.held.items():
                with suppress(*REFUSALS):
                    await self._supervisor.camera.set_control(control, value)
            if self.held:
                self._supervisor.note_exposure()

    async def _look(self) -> tuple[ControlState, ...]:
        self.latest = ()
        # A camera that has failed is opened again by others, and none of its controls ends the node.
        with suppress(*REFUSALS):
            self.latest = await self._supervisor.camera.controls()
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
        await self._supervisor.camera.set_control(control, nearest)
        self.held[control] = nearest
        self._locked.discard(control)
        if value == "hold" and state.automatic and control not in self._live:
            return f"it may not tell the {control} that it had chosen: look whether the picture has changed"
        if nearest != asked:
            return f"{asked:g} {state.unit} is out of its range, {state.least:g} to {state.most:g}"
        return ""

    async def _release(self, state: ControlState) -> str:
        if not state.can_be_automatic:
            return f"it does not choose its {state.control} itself"
        self.held.pop(state.control, None)
        self._locked.discard(state.control)
        await self._supervisor.camera.set_control(state.control, None)
        return ""

    # What is locked for a burst is not told to the engine: an exposure that becomes known moves the moment of
    # light that stamps are taken for, and with it the grid, just when a burst is picked.

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
        """Have the camera choose again what is locked; what it refuses stays locked, until the next time."""
        for control in tuple(self._locked):
            with suppress(*REFUSALS):
                await self._supervisor.camera.set_control(control, None)
                self._locked.discard(control)


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeOptions:
    """What a node is given by whoever starts it."""

    name: str
    open_camera: Callable[[], Camera]
    """Called at the start, and again after each failure of the device."""
    leaders: tuple[Address, ...]
    """Leaders or relays of one rig, asked in turn."""
    clock: NodeClock = field(default_factory=HostClock)
    tolerance_ns: int | None = None
    """The largest phase error that is not corrected; None for the usual one of the camera's kind."""
    ring_ns: int = RING_NS
    """How long frames are kept for bursts in the past, at most."""
    ring_bytes: int = RING_BYTES
    """How much memory they take at most, and as much those that are not on a disk yet."""
    spool: Path | None = None
    """A folder for the images that the leader does not have yet; memory holds them without one."""
    profiles: DeviceProfiles | None = None
    """How devices like this one were moved before; they are told, too."""
    trust: Trust = field(default_factory=Trust.of_user)
    """Whom it follows."""
    log: Log = field(default_factory=Log)
    """Takes what a user may see."""
    put_off: Callable[[], None] = lambda: None
    """Called when an operator takes it off the rig, where whoever starts it can see to that."""


class FrameReceiver(Protocol):
    """Whatever is given the frames of a camera."""

    def add_frame(self, frame: CapturedFrame) -> None:
        """Take in the next frame."""


class CameraStream:
    """A camera that streams, over as many openings of the device as there are; `start` makes one.

    Each receiver is given each frame in order. Frames that come before there is a receiver are dropped.
    """

    camera: Camera
    """The one that is open."""
    facts: CameraFacts
    """What the camera is and can do, and what is known of its stamps."""
    failed: asyncio.Future[Exception]
    """The error of the device once it has failed."""
    started_ns: int
    """When the camera was told to start, in ns of the node's clock."""

    def __init__(self, options: NodeOptions) -> None:
        self._options = options
        self._set_stamp: StampAccuracy | None = None
        self.receivers: list[FrameReceiver] = []

    @classmethod
    async def start(cls, options: NodeOptions) -> Self:
        """Open a node's camera and start its stream. Raises what the camera raises."""
        stream = cls(options)
        await stream.open()
        return stream

    async def open(self) -> None:
        """Open the camera, again where it has failed, and start its stream. Raises what the camera raises."""
        self.camera = self._options.open_camera()
        self.started_ns = self._options.clock.now_ns()
        failed = self.failed = asyncio.get_running_loop().create_future()

        def on_failure(error: Exception) -> None:
            if not failed.done():
                failed.set_result(error)

        await self.camera.start(self._deliver, on_failure)
        self.update_facts()

    def set_stamp(self, stamp: StampAccuracy) -> None:
        """Use a newly measured accuracy of the camera's stamps, from the next `update_facts` on."""
        self._set_stamp = stamp

    def update_facts(self) -> None:
        """Read the camera's facts, with what is known of its stamps, as the leader and sessions get them."""
        facts = self.camera.facts
        told, just_set = facts.stamp_accuracy, self._set_stamp
        if just_set is not None and just_set.exposure_ns == facts.exposure_ns:
            self.facts = replace(facts, stamp=just_set)
            return
        profiles, measured = self._options.profiles, None
        if profiles is not None and not told.is_exact:
            measured = profiles.stamp(self._options.name, facts)
        self.facts = replace(facts, stamp=measured or told)

    def _deliver(self, frame: CapturedFrame) -> None:
        for receiver in self.receivers:
            receiver.add_frame(frame)


class CameraSupervisor:
    """Feeds an engine a camera's stream, carries out its commands, and reopens the camera when it fails."""

    def __init__(
        self,
        options: NodeOptions,
        stream: CameraStream,
        engine: Client[CapturedFrame],
        pump: Pump,
        *,
        retry_s: float = RETRY_S,
    ) -> None:
        """`pump` runs the engine; a camera that has failed is opened again each `retry_s`."""
        self._options, self._retry_s = options, retry_s
        self._stream, self._engine, self._pump = stream, engine, pump
        self._commands: asyncio.Queue[tuple[CameraCommand, int]] = asyncio.Queue()
        """Each with the local time in ns that the engine reckoned with."""
        self._engine_ns = 0
        self.controls = ControlKeeper(self)
        """Exposure, gain, white balance and focus."""
        self._streams_before = self._last_stream = 0
        engine.stream_started(stream.started_ns)
        stream.receivers.append(self)

    @property
    def camera(self) -> Camera:
        """The one that is open."""
        return self._stream.camera

    def collect_commands(self) -> None:
        """Queue what the engine asks of the camera, and hold its controls while frames of a burst come."""
        self.controls.set_in_burst(self._engine.has_burst_pending)
        while (command := self._engine.next_command()) is not None:
            self._commands.put_nowait((command, self._engine_ns))

    async def keep_open(self) -> None:
        """Wait for the device to fail, and then try to open it again and again, for ever.

        Raises CameraError where another camera is there then.
        """
        while True:
            error = await self._stream.failed
            self._options.log.say(f"camera failed: {error}")
            self._tell_engine(str(error))
            await self.camera.stop()
            await self._reopen()
            await self.controls.restore()
            self._options.log.say("camera is back")
            self._tell_engine("")

    async def carry_out_commands(self) -> None:
        """Apply the queued commands in their order, for ever."""
        while True:
            command, reckoned_ns = await self._commands.get()
            given_ns = self._options.clock.now_ns()
            if isinstance(command, RestartStream):
                delay_ns = command.delay_ns - (given_ns - reckoned_ns)
                # Too late for the start aimed at: the same place in a later period is as good.
                late = delay_ns < 0
                command = RestartStream(delay_ns % self._stream.facts.period_ns if late else delay_ns)
            try:
                await self.camera.apply(command)
            except CameraError as error:
                self._options.log.say(f"camera refused a command: {error}")
                continue
            if isinstance(command, RestartStream):
                # Cameras keep to this moment, or to whole periods after it, however late this loop is.
                self._engine.stream_started(given_ns + command.delay_ns)

    async def _reopen(self) -> None:
        before = self._stream.facts
        self._streams_before = self._last_stream + 1
        while True:
            await asyncio.sleep(self._retry_s)
            try:
                await self._stream.open()
                break
            except SimulshotError as reason:
                await self.camera.stop()
                self._tell_engine(str(reason))
        # A camera that was unplugged forgets its exposure; that makes it no other camera.
        facts = self._stream.facts
        if replace(facts, exposure_ns=before.exposure_ns, stamp=before.stamp) != before:
            raise CameraError(f"another camera is connected now: {facts.model}", hint="start the node again")
        self._engine.stream_started(self._stream.started_ns)

    def note_exposure(self) -> None:
        """Tell the engine if the camera's exposure, or what is known of its stamps, has changed."""
        before = self._stream.facts
        self._stream.update_facts()
        if self._stream.facts != before:
            self._engine.update_camera(self._stream.facts)

    def add_frame(self, frame: CapturedFrame) -> None:
        """Give the engine the next frame."""
        # A camera that was opened again counts its streams from the start; the engine's count goes on.
        self._last_stream = self._streams_before + frame.stream
        stamp = FrameStamp(frame.sequence, self._last_stream, frame.timestamp_ns)
        self._engine_ns = self._options.clock.now_ns()
        self._engine.frame_arrived(stamp, frame, self._engine_ns, frame.picture.held_bytes)
        self._pump.turn()

    def _tell_engine(self, failure: str) -> None:
        self._engine.fail(failure)
        self._pump.turn()
