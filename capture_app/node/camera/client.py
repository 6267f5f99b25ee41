"""One camera node: the camera, the engine on a socket, and the way of its images to the leader."""

import asyncio
import random
import secrets
import socket
from collections import deque
from collections.abc import Callable
from pathlib import Path

from msgspec.structs import replace

from capture_app.camera_facts import CameraFacts, PhaseControl
from capture_app.cameras.base import Camera, CapturedFrame
from capture_app.clock import HostClock, NodeClock
from capture_app.errors import CameraError, NetworkError, SimulshotError
from capture_app.net.address import Address, resolve
from capture_app.net.multicast import BeaconEar
from capture_app.net.udp import Pump, client_socket
from capture_app.node.camera.device_profiles import DeviceProfiles
from capture_app.node.camera.records import camera_record, camera_report, event_line, true_clock
from capture_app.node.transfer.spool import Spool
from capture_app.node.transfer.uploader import Uploader
from capture_app.node.transfer.work import BurstWork
from capture_app.node.wire.messages import JsonValue
from capture_app.session.format.manifest import CameraRecord
from capture_app.sync.phase.estimator import FrameStamp
from capture_app.sync.rig.client import Client
from capture_app.sync.rig.events import (
    AlignmentFailed,
    BurstPicked,
    ClientEvent,
    Joined,
    JoinRefused,
    LeaderLost,
)
from capture_app.sync.rig.failover import Failover
from capture_app.sync.rig.phase_loop import ClientConfig
from capture_app.sync.wire.camera_commands import CameraCommand, RestartStream
from capture_app.sync.wire.messages import NodeState

RING_FRAMES = 90
CAMERA_RETRY_S = 2.0
EVENTS_KEPT = 200
DEFAULT_TOLERANCE_NS = 100_000
RESET_TOLERANCE_NS = 2_000_000
"""The same for a camera that can only restart its stream, whose start latency is uncertain by as much."""


class ClientNode:
    """A camera that joins a leader, stays in step, and never gives up when the leader goes away."""

    def __init__(
        self,
        *,
        name: str,
        open_camera: Callable[[], Camera],
        leader: Address,
        others: tuple[Address, ...] = (),
        clock: NodeClock | None = None,
        tolerance_ns: int | None = None,
        ring_frames: int = RING_FRAMES,
        talk: Callable[[str], None] | None = None,
        spool: Path | None = None,
        profiles: DeviceProfiles | None = None,
    ) -> None:
        """`open_camera` is called again after each failure of the device; `talk` gets what a user may see.

        `others` are asked in turn where the leader, or relay, is gone; they must be of the same rig.
        `spool` is the folder that bursts are kept in until the leader has them; without one, memory is.
        `profiles` tell how devices like this one were moved before, and are told.
        """
        self.name = name
        self._open_camera = open_camera
        self._leaders = (leader, *others)
        self._clock: NodeClock = clock or HostClock()
        self._tolerance_ns = tolerance_ns
        self._ring_frames = ring_frames
        self._profiles = profiles
        self._talk = talk or _silent
        self._camera: Camera
        self._facts: CameraFacts
        self._engine: Client[CapturedFrame] | None = None
        self._failover: Failover[CapturedFrame]
        self._pump: Pump | None = None
        self._ear: BeaconEar
        self._uploader = Uploader(self._talk, None if spool is None else Spool(spool, name))
        self._commands: asyncio.Queue[tuple[CameraCommand, int]] = asyncio.Queue()
        """Each with the local time in ns that the engine reckoned with."""
        self._engine_ns = 0
        self._streams_before = self._last_stream = 0
        self._events: deque[dict[str, JsonValue]] = deque(maxlen=EVENTS_KEPT)
        self._last_state: NodeState | None = None

    async def run(self) -> None:
        """Open the camera, join, and take pictures until cancelled.

        Raises NetworkError where the leader's host has no address, CameraError where the camera cannot be
        opened at the start, BadInputError for a spool that cannot be used; later failures are waited out.
        """
        self._uploader.load_spool()
        try:
            await self._open_and_run()
        finally:
            self._uploader.close()

    async def _open_and_run(self) -> None:
        found = [await resolve(leader) for leader in self._leaders]
        family = found[0][0]
        if any(other != family for other, _ in found):
            raise NetworkError(
                f"{' and '.join(map(str, self._leaders))} are not of one kind (IPv4 and IPv6)",
                hint="give all of them as IPv4, or all as IPv6",
            )
        peers = tuple(peer for _, peer in found)
        self._camera = self._open_camera()
        started_ns = self._clock.now_ns()
        failed = await self._start_camera()
        try:
            await self._run_with_camera(failed, started_ns, client_socket(family), peers)
        finally:
            await self._camera.stop()

    async def _run_with_camera(
        self,
        failed: "asyncio.Future[Exception]",
        started_ns: int,
        sock: socket.socket,
        peers: tuple[Address, ...],
    ) -> None:
        if self._tolerance_ns is None:
            only_restarts = self._facts.phase_control is PhaseControl.RESET
            self._tolerance_ns = RESET_TOLERANCE_NS if only_restarts else DEFAULT_TOLERANCE_NS
        config = ClientConfig(
            name=self.name,
            instance=secrets.randbits(32),
            camera=self._facts,
            tolerance_ns=self._tolerance_ns,
            ring_frames=self._ring_frames,
            injection_profile=self._profiles.find(self._facts) if self._profiles else None,
            start_latencies_ns=self._profiles.start_latencies_ns(self._facts) if self._profiles else (),
        )
        self._engine = Client(config, random.Random(secrets.randbits(64)))
        self._engine.stream_started(started_ns)
        self._failover = Failover(self._engine, peers)
        self._pump = Pump(self._failover, self._clock.now_ns, self._drain)
        self._ear = BeaconEar(self._engine.receive_broadcast, self._clock.now_ns, self._pump.turn)
        self._pump.start(sock)
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._keep_camera(failed))
                tasks.create_task(self._command_camera())
                tasks.create_task(self._uploader.run())
        except* SimulshotError as group:
            raise group.exceptions[0] from None
        finally:
            self._talk = _silent
            self._engine.leave()
            self._pump.turn()
            self._pump.close()
            self._ear.close()

    # The camera

    async def _start_camera(self) -> "asyncio.Future[Exception]":
        """Start the stream; the future tells when the device goes away."""
        failed: asyncio.Future[Exception] = asyncio.get_running_loop().create_future()

        def on_failure(error: Exception) -> None:
            if not failed.done():
                failed.set_result(error)

        # A camera that was opened again counts its streams from the start; the engine's count goes on.
        self._streams_before = self._last_stream + 1
        await self._camera.start(self._frame_arrived, on_failure)
        self._facts = self._camera.facts
        return failed

    async def _keep_camera(self, failed: "asyncio.Future[Exception] | None") -> None:
        """Wait for the device to fail, and then try to open it again and again."""
        assert self._engine is not None
        while True:
            if failed is not None:
                error = await failed
                self._talk(f"camera failed: {error}")
                self._tell_failure(str(error))
                await self._camera.stop()
                failed = None
            await asyncio.sleep(CAMERA_RETRY_S)
            before = self._facts
            try:
                self._camera = self._open_camera()
                started_ns = self._clock.now_ns()
                failed = await self._start_camera()
            except SimulshotError as reason:
                await self._camera.stop()
                self._tell_failure(str(reason))
                continue
            # A camera that was unplugged forgets its exposure; that makes it no other camera.
            if replace(self._facts, exposure_ns=before.exposure_ns) != before:
                raise CameraError(
                    f"another camera is there now: {self._facts.model}", hint="start the node again"
                )
            self._engine.stream_started(started_ns)
            self._talk("camera is back")
            self._tell_failure("")

    def _tell_failure(self, reason: str) -> None:
        assert self._engine is not None
        assert self._pump is not None
        self._engine.fail(reason)
        self._pump.turn()

    def _frame_arrived(self, frame: CapturedFrame) -> None:
        if self._engine is None or self._pump is None:
            return
        self._last_stream = self._streams_before + frame.stream
        stamp = FrameStamp(frame.sequence, self._last_stream, frame.timestamp_ns)
        self._engine_ns = self._clock.now_ns()
        self._engine.frame_arrived(stamp, frame, self._engine_ns)
        self._pump.turn()

    async def _command_camera(self) -> None:
        assert self._engine is not None
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
            if isinstance(command, RestartStream):
                # Cameras keep to this moment, or to whole periods after it, however late this loop is.
                self._engine.stream_started(given_ns + command.delay_ns)

    # The engine

    def _drain(self) -> None:
        assert self._engine is not None
        while (command := self._engine.next_command()) is not None:
            self._commands.put_nowait((command, self._engine_ns))
        while (event := self._engine.next_event()) is not None:
            self._take_event(event)
        state = self._engine.state
        if state is not self._last_state:
            self._last_state = state
            self._talk(str(state))
            if state is NodeState.READY:
                self._keep_profile()

    def _keep_profile(self) -> None:
        """Keep what brought the camera into phase: it is proven."""
        assert self._engine is not None
        aligner = self._engine.aligner
        if self._profiles is not None and aligner.injection_profile is not None:
            self._profiles.keep(self._facts, aligner.injection_profile)
        if self._profiles is not None and aligner.start_latencies_ns:
            self._profiles.keep_start_latencies(self._facts, aligner.start_latencies_ns)

    def _take_event(self, event: ClientEvent[CapturedFrame]) -> None:
        now_ns = self._clock.now_ns()
        if isinstance(event, BurstPicked):
            self._uploader.add(self._work_of(event))
            return
        if isinstance(event, Joined):
            camera = CameraRecord(name=self.name, facts=self._facts)
            leader = Address(self._failover.leader[0], event.transfer_port)
            self._uploader.leader_found(leader, camera)
            self._ear.follow(event.beacons, leader.host)
            if len(self._leaders) > 1:
                self._talk(f"joined {leader}")
        line = {"local_ns": now_ns, **event_line(event)}
        self._events.append(line)
        if isinstance(event, LeaderLost | JoinRefused | AlignmentFailed):
            self._talk(f"{line['event']}: {event.reason}")

    def _work_of(self, ready: BurstPicked[CapturedFrame]) -> BurstWork:
        assert self._engine is not None
        assert self._tolerance_ns is not None
        record = camera_record(
            self.name, self._facts, ready, self._engine.aligner.corrections, self._tolerance_ns
        )
        report = camera_report(
            record,
            ready,
            calibration=self._camera.calibration,
            true_clock=true_clock(self._clock, self._facts),
            events=tuple(self._events),
        )
        self._events.clear()
        return BurstWork(report, deque(ready.picks))


def _silent(_: str) -> None:
    """Nobody listens."""
