"""One camera node: the camera, the engine on a socket, and the way of its images to the leader.

What a node keeps of its latest exchanges and lines, for whoever asks for its details.
"""

import asyncio
import contextlib
import random
import secrets
import socket
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

from capture_app.camera_facts import PhaseControl, StampAccuracy
from capture_app.cameras.base import Camera, CapturedFrame
from capture_app.clock import HostClock, HostRate, NodeClock
from capture_app.errors import NetworkError, ungrouped_errors
from capture_app.net.address import Address, resolve
from capture_app.net.multicast import BeaconReceiver
from capture_app.net.udp import Pump, client_socket
from capture_app.node.camera.device_profiles import DeviceProfiles
from capture_app.node.camera.records import event_line, event_words
from capture_app.node.camera.spool import Spool
from capture_app.node.camera.supervisor import CameraSupervisor
from capture_app.node.camera.uploader import PickedBursts, Uploader
from capture_app.node.camera.viewfinder import Viewfinder
from capture_app.node.join_watch import JoinWatch
from capture_app.node.keys import KeyRequester
from capture_app.node.wire.messages import KeyRequest
from capture_app.node.wire.operating import Vitals
from capture_app.node.wire.status import NewsLine, NodeDetail
from capture_app.session.files.disk import free_bytes
from capture_app.sync.clock.clock_filter import ClockSample
from capture_app.sync.rig import events
from capture_app.sync.rig.client import Client
from capture_app.sync.rig.failover import Failover
from capture_app.sync.rig.frame_picks import RING_BYTES, RING_NS
from capture_app.sync.rig.phase_loop import ClientConfig
from capture_app.sync.wire.messages import NodeState
from capture_app.trust.sealed_engines import SealedClient
from capture_app.trust.trust import Trust

SAMPLES_KEPT = 300
LINES_KEPT = 100


class NodeJournal:
    """One node's."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._samples: deque[ClockSample] = deque(maxlen=SAMPLES_KEPT)
        self._lines: deque[NewsLine] = deque(maxlen=LINES_KEPT)

    def add_sample(self, sample: ClockSample) -> None:
        """Keep an exchange with the leader."""
        self._samples.append(sample)

    def forget_samples(self) -> None:
        """Another leader has another clock."""
        self._samples.clear()

    def add_line(self, text: str) -> None:
        """Keep what the node has said."""
        self._lines.append(NewsLine(unix_ns=time.time_ns(), text=text, camera=self._name))

    def detail(
        self,
        vitals: Vitals,
        *,
        skew_ppm: float | None,
        phase_errors_ns: tuple[int, ...],
        newest: CapturedFrame | None,
        spool: Path | None,
    ) -> NodeDetail:
        """Return all of it, with how the camera runs and where its images wait.

        By `skew_ppm` the leader's clock gains on this one; its share is taken off the offsets, which then
        show by what the exchanges erred.
        """
        rate = (skew_ppm or 0.0) * 1e-6
        last_ns = self._samples[-1].t3_ns if self._samples else 0
        samples = tuple(
            (
                (sample.lower_ns + sample.upper_ns) // 2 + round(rate * (last_ns - sample.t3_ns)),
                sample.round_trip_ns,
            )
            for sample in self._samples
        )
        return NodeDetail(
            camera=self._name,
            samples=samples,
            phase_errors_ns=phase_errors_ns,
            log=tuple(self._lines),
            fps=vitals.fps,
            exposure_ns=vitals.exposure_ns,
            gain=vitals.gain,
            white_balance=None if newest is None else newest.white_balance,
            spool="" if spool is None else str(spool),
            disk_free_bytes=None if spool is None else free_bytes(spool),
        )


DEFAULT_TOLERANCE_NS = 100_000
RESET_TOLERANCE_NS = 2_000_000
"""The same for a camera that can only restart its stream, whose start latency is uncertain by as much."""


class CameraNode:
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
        ring_ns: int = RING_NS,
        ring_bytes: int = RING_BYTES,
        talk: Callable[[str], None] | None = None,
        spool: Path | None = None,
        profiles: DeviceProfiles | None = None,
        trust: Trust | None = None,
    ) -> None:
        """`open_camera` is called again after each failure of the device; `talk` gets what a user may see.

        `others` are asked in turn where the leader, or relay, is gone; they must be of the same rig.
        `ring_ns` and `ring_bytes` bound the frames that are kept for bursts in the past.
        `spool` is the folder that bursts are kept in until the leader has them; without one, memory is.
        `profiles` tell how devices like this one were moved before, and are told.
        `trust` is whom it follows, else its user's.
        """
        self.name = name
        self._leaders = (leader, *others)
        self._clock: NodeClock = clock or HostClock()
        self._tolerance_ns = tolerance_ns
        self._ring_ns, self._ring_bytes = ring_ns, ring_bytes
        self._profiles = profiles
        self._trust = trust or Trust.of_user()
        self._tell = talk or (lambda _: None)
        self._journal = NodeJournal(name)
        self._camera = CameraSupervisor(
            open_camera,
            self._clock,
            self._talk,
            measured_stamp=lambda facts: None if profiles is None else profiles.stamp(name, facts),
        )
        self._engine: Client[CapturedFrame]
        self._failover: Failover[CapturedFrame]
        self._sealed: SealedClient | None = None
        self._keys: KeyRequester | None = None
        self._pump: Pump
        self._beacons: BeaconReceiver
        # Whoever knows it speaks for this camera: too many to be guessed.
        self._instance = secrets.randbits(62)
        self._uploader = Uploader(
            name,
            self._instance,
            self._talk,
            None if spool is None else Spool(spool, name),
            trust=self._trust,
        )
        self._viewfinder = Viewfinder(
            name,
            self._instance,
            now_ns=self._clock.now_ns,
            leader_ns=lambda local_ns: (
                None if self._engine.time_map is None else self._engine.time_map.leader_from_local(local_ns)
            ),
            is_busy=lambda: self._engine.has_burst_pending or self._uploader.is_busy,
            detail=self._detail,
            controls=self._camera.controls,
            keep_stamp=self._keep_stamp,
            trust=self._trust,
        )
        self._picked = PickedBursts(name, self._camera, self._clock, self._uploader, ring_bytes)
        self._host_rate = HostRate()
        self._last_state: NodeState | None = None
        self._watch = JoinWatch(self._leaders, self._talk)

    async def run(self) -> None:
        """Open the camera, join, and take pictures until cancelled.

        Raises NetworkError where the leader's host has no address, CameraError where the camera cannot be
        opened at the start, BadInputError for a spool or a key of this machine's that cannot be used; later
        failures are waited out.
        """
        with contextlib.closing(self._uploader):
            self._uploader.load_spool()
            self._trust.client_context()
            found = [await resolve(leader) for leader in self._leaders]
            family = found[0][0]
            if any(other != family for other, _ in found):
                raise NetworkError(
                    f"{' and '.join(map(str, self._leaders))} are not of one kind (IPv4 and IPv6)",
                    hint="give all of them as IPv4, or all as IPv6",
                )
            self._watch.look_ahead()
            await self._camera.start()
            try:
                await self._run_with_camera(client_socket(family), tuple(peer for _, peer in found))
            finally:
                await self._camera.stop()

    async def _run_with_camera(self, sock: socket.socket, peers: tuple[Address, ...]) -> None:
        facts = self._camera.facts
        if self._tolerance_ns is None:
            only_restarts = facts.phase_control is PhaseControl.RESET
            self._tolerance_ns = RESET_TOLERANCE_NS if only_restarts else DEFAULT_TOLERANCE_NS
        config = ClientConfig(
            name=self.name,
            instance=self._instance,
            camera=facts,
            tolerance_ns=self._tolerance_ns,
            ring_ns=self._ring_ns,
            ring_bytes=self._ring_bytes,
            injection_profile=self._profiles.injection_profile(facts) if self._profiles else None,
            start_latencies_ns=self._profiles.start_latencies_ns(facts) if self._profiles else (),
        )
        rng = random.Random(secrets.randbits(64))
        self._engine = Client(
            config,
            rng,
            on_sample=self._journal.add_sample,
            size_of=lambda frame: frame.picture.held_bytes,
        )
        self._failover = Failover(self._engine, peers)
        if not self._trust.is_open:
            self._sealed = SealedClient(self._failover)
        self._pump = Pump(self._sealed or self._failover, self._clock, self._drain)
        self._beacons = BeaconReceiver(self._receive_broadcast, self._clock, self._pump.turn)
        self._camera.attach(self._engine, self._pump.turn, self._viewfinder.add_frame)
        self._pump.start(sock)
        try:
            with ungrouped_errors():
                async with asyncio.TaskGroup() as tasks:
                    if self._sealed is not None:
                        request = KeyRequest(name=self.name, instance=self._instance)
                        self._keys = KeyRequester(
                            self._sealed.keys, request, self._engine.time, self._trust, self._pump.turn
                        )
                        tasks.create_task(self._keys.run())
                    tasks.create_task(self._camera.keep_open())
                    tasks.create_task(self._camera.carry_out_commands())
                    tasks.create_task(self._camera.controls.run())
                    tasks.create_task(self._uploader.run())
                    tasks.create_task(self._viewfinder.run())
                    tasks.create_task(self._watch.run(self._engine.time))
        finally:
            self._tell = lambda _: None
            self._engine.leave()
            self._pump.turn()
            self._pump.close()
            self._beacons.close()

    @property
    def standing(self) -> tuple[NodeState | None, str]:
        """How far it is, None before it has begun, and why it is not further in plain words."""
        if self._last_state is None:
            return None, ""
        return self._last_state, self._engine.report(self._clock.now_ns()).message

    def _receive_broadcast(self, data: bytes, now_ns: int) -> None:
        message = data if self._sealed is None else self._sealed.open_broadcast(data)
        if message is not None:
            self._engine.receive_broadcast(message, now_ns)

    def _talk(self, line: str) -> None:
        self._journal.add_line(line)
        self._tell(line)

    def _detail(self) -> NodeDetail:
        errors_ns = (self._engine.phase_error_ns(stamp) for stamp in self._viewfinder.stamps_ns)
        spool = self._uploader.spool
        return self._journal.detail(
            self._viewfinder.vitals,
            skew_ppm=self._engine.report(self._clock.now_ns()).skew_ppm,
            phase_errors_ns=tuple(error for error in errors_ns if error is not None),
            newest=self._viewfinder.newest,
            spool=None if spool is None else spool.folder,
        )

    def _drain(self) -> None:
        self._camera.collect_commands()
        self._engine.time.timekeeper.rate.host_slewing_ppm = self._host_rate.slewing_ppm(self._clock.now_ns())
        if self._keys is not None:
            self._keys.look()
        while (event := self._engine.next_event()) is not None:
            self._handle_event(event)
        for refused in () if self._sealed is None else self._sealed.refusals.take_news(self._clock.now_ns()):
            self._talk(str(refused))
        state = self._engine.state
        if state != self._last_state:
            self._last_state = state
            message = self._engine.report(self._clock.now_ns()).message
            self._talk(f"{state}: {message}" if message else str(state))
            if state is NodeState.READY:
                self._keep_profile()

    def _keep_stamp(self, stamp: StampAccuracy) -> bool:
        """Go by a measured stamp from now on; whether it is kept for the next time, too."""
        facts = self._camera.facts
        self._camera.set_stamp(stamp)
        self._pump.turn()
        return self._profiles is not None and self._profiles.save_stamp(self.name, facts, stamp)

    def _keep_profile(self) -> None:
        """Keep what brought the camera into phase: it is proven."""
        aligner = self._engine.aligner
        if self._profiles is not None and aligner.injection_profile is not None:
            self._profiles.save_injection(self._camera.facts, aligner.injection_profile)
        if self._profiles is not None and aligner.start_latencies_ns:
            self._profiles.save_start_latencies(self._camera.facts, aligner.start_latencies_ns)

    def _handle_event(self, event: events.ClientEvent[CapturedFrame]) -> None:
        now_ns = self._clock.now_ns()
        if isinstance(event, events.BurstPicked):
            assert self._tolerance_ns is not None
            self._picked.upload(event, self._engine, self._tolerance_ns)
            return
        if isinstance(event, events.BurstCancelled):
            self._uploader.cancel_burst(event.leader, event.burst)
        if isinstance(event, events.Joined):
            leader = Address(self._failover.leader[0], event.transfer_port)
            assert self._engine.time.terms is not None, "it has joined"
            self._uploader.set_leader(leader, self._engine.time.terms.path[0])
            self._viewfinder.set_leader(leader)
            self._journal.forget_samples()
            self._beacons.follow(event.beacons, leader.host)
            if len(self._leaders) > 1:
                self._talk(f"joined {leader}")
        self._picked.note({"local_ns": now_ns, **event_line(event)})
        if words := event_words(event):
            self._talk(words)
