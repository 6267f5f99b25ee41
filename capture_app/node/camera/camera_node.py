"""One camera node: its camera, the engine on a socket, and the upload of its images to the leader."""

import asyncio
import contextlib
import functools
import random
import secrets
import socket
from collections import deque
from collections.abc import Mapping
from typing import Any

import msgspec
from msgspec.structs import replace

from capture_app.cameras.base import DeviceClock
from capture_app.cameras.frames import CapturedFrame
from capture_app.common.address import Address, resolve
from capture_app.common.camera_facts import SIMULATED, CameraFacts, Control
from capture_app.common.clock import SimulatedClock
from capture_app.common.errors import NetworkError, ungrouped_errors
from capture_app.common.node_state import NodeState
from capture_app.net.udp import client_socket
from capture_app.node.camera.burst_upload import Upload
from capture_app.node.camera.device_profiles import link_key, mode_key, node_key
from capture_app.node.camera.spool import Spool
from capture_app.node.camera.supervisor import CameraSupervisor, NodeOptions
from capture_app.node.camera.uploader import Uploader
from capture_app.node.camera.viewfinder import Viewfinder
from capture_app.node.endpoint import Endpoint
from capture_app.protocol.event_text import client_line, client_record, why_doubted
from capture_app.protocol.messages import MAX_EVENTS, CameraReport, EventValue
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import (
    CameraRecord,
    ClockRecord,
    PhaseMove,
    PhaseRecord,
    WidenedTimes,
)
from capture_app.sync.clock.clock_filter import ClockSample
from capture_app.sync.rig import events
from capture_app.sync.rig.client import Client, ClientConfig
from capture_app.sync.rig.failover import Failover
from capture_app.sync.rig.frame_selection import FramesSelected
from capture_app.sync.timekeeping.clock_events import TimesDoubted
from capture_app.trust.sealed_engines import SealedClient

MAX_SAMPLES = 300


class CameraNode:
    """A camera that joins a leader, stays synchronized, and keeps trying while the leader is lost."""

    def __init__(self, options: NodeOptions) -> None:
        self.options, self._log, self._clock = options, options.log, options.clock
        self._last_state: NodeState | None = None

    async def run(self) -> None:
        """Open the camera, join, and capture until cancelled.

        Raises NetworkError where the leader's host has no address, CameraError where the camera cannot be
        opened at the start, BadInputError for an unusable spool or machine key. Later failures are retried.
        """
        options = self.options
        self._last_state = None
        # Anyone who knows the number can speak for this camera, so it has too many bits to be guessed.
        instance = secrets.randbits(62)
        spool = None if options.spool is None else Spool(options.spool, options.name)
        self._uploader = Uploader(options.name, instance, options.log, spool, trust=options.trust)
        async with contextlib.AsyncExitStack() as ending:
            if spool is not None:
                ending.callback(spool.close)
            ending.push_async_callback(self._uploader.aclose)
            await asyncio.to_thread(self._uploader.load_spool)
            options.trust.client_context()
            addresses = [await resolve(leader) for leader in options.leaders]
            family = addresses[0][0]
            if any(other != family for other, _ in addresses):
                raise NetworkError(
                    f"{' and '.join(map(str, options.leaders))} mix IPv4 and IPv6",
                    hint="give all of them as IPv4, or all as IPv6",
                )
            self._camera = CameraSupervisor(options)
            await self._camera.open()
            try:
                self._prepare(instance, tuple(peer for _, peer in addresses))
                await self._take_part(client_socket(family))
            finally:
                await self._camera.camera.stop()

    def _prepare(self, instance: int, peers: tuple[Address, ...]) -> None:
        """Make the engine of the run `instance`, for the leaders at `peers`, and connect all parts to it."""
        options, facts = self.options, self._camera.facts
        profile, node = options.profiles.read(mode_key(facts)), node_key(options.name)
        self._samples: deque[ClockSample] = deque(maxlen=MAX_SAMPLES)
        """The latest exchanges with the leader."""
        self._stepped: TimesDoubted | None = None
        """The last step of a clock: frames from before it that are selected afterwards have wrong times."""
        self._happened: deque[dict[str, EventValue]] = deque(maxlen=MAX_EVENTS)
        """Events for the next burst's report."""
        self._engine: Client[CapturedFrame] = Client(
            ClientConfig(
                name=options.name,
                instance=instance,
                camera=facts,
                tolerance_ns=options.tolerance_ns,
                clock_tolerance_ns=options.clock_tolerance_ns,
                ring_ns=options.ring_ns,
                ring_bytes=options.ring_bytes,
                injection_profile=profile.usable_injection,
                start_latencies_ns=profile.start_latencies_ns,
                moves_in_recordings=options.moves_in_recordings,
            ),
            random.Random(secrets.randbits(64)),
            samples=self._samples,
        )
        self._failover = Failover(self._engine, peers)
        sealed = SealedClient(self._failover)
        self._refusals = sealed.refusals
        self._endpoint = Endpoint(options, self._failover, sealed, self._drain)
        self._joining = self._endpoint.join(
            self._failover,
            sealed.leader_keys,
            options.leaders,
            followed=options.profiles.read(node).followed,
            remember=lambda followed: options.profiles.save(node, followed=followed),
        )
        self._camera.connect(self._engine, self._endpoint.pump)
        self._viewfinder = Viewfinder(
            options, instance, self._camera, self._engine, self._uploader, self._samples
        )
        self._camera.receivers.append(self._viewfinder.add_frame)

    async def _take_part(self, sock: socket.socket) -> None:
        """Take part over a UDP socket until cancelled."""
        self._endpoint.pump.start(sock)
        try:
            with ungrouped_errors():
                async with asyncio.TaskGroup() as tasks:
                    for work in (
                        self._joining.run(),
                        self._camera.keep_open(),
                        self._camera.carry_out_commands(),
                        self._camera.controls.run(),
                        self._uploader.run(),
                        self._viewfinder.run(),
                    ):
                        tasks.create_task(work)
        finally:
            await self._endpoint.stop()

    @property
    def standing(self) -> tuple[NodeState | None, str]:
        """The node's state, None before it has begun, and in plain words why it is not ready."""
        message = "" if self._last_state is None else self._engine.report(self._clock.now_ns()).message
        return self._last_state, message

    # Events of the engine

    def _drain(self, now_ns: int) -> None:
        self._camera.notice_sleep()
        self._camera.collect_commands()
        self._engine.upload_problem = self._uploader.problem
        while (event := self._engine.next_event()) is not None:
            self._handle_event(event)
        for refused in self._refusals.take_events(now_ns):
            self._log.say(str(refused))
        state = self._engine.state
        if state != self._last_state:
            self._last_state = state
            report = self._engine.report(now_ns)
            words = state.with_error(report.uncertainty_ns)
            self._log.say(f"{words}: {report.message}" if report.message else words)
            if state is NodeState.READY:
                # What brought the camera into phase is proven now.
                aligner = self._engine.aligner
                proven = {
                    "injection": aligner.actuator.profile,
                    "start_latencies_ns": aligner.start_latencies_ns,
                }
                changes = {name: value for name, value in proven.items() if value}
                save = functools.partial(self.options.profiles.save, mode_key(self._camera.facts), **changes)
                # It waits for the disk, and for the other nodes of this machine.
                asyncio.get_running_loop().run_in_executor(None, save)

    def _handle_event(self, event: events.ClientEvent[CapturedFrame]) -> None:
        if isinstance(event, FramesSelected):
            self._upload(event)
            return
        if isinstance(event, events.TriggerCancelled):
            self._uploader.cancel_burst(event.leader, event.burst)
        if isinstance(event, events.Joined):
            leader = Address(self._failover.leader[0], event.transfer_port)
            assert self._engine.followed is not None, "it has joined"
            self._uploader.set_leader(leader, self._engine.followed.path[0])
            self._viewfinder.set_leader(leader)
            self._samples.clear()
            link = self.options.profiles.read(link_key(self.options.name, leader.host))
            self._engine.timekeeper.clock.asymmetry = link.asymmetry
            if len(self.options.leaders) > 1:
                self._log.say(f"joined {leader}")
        if isinstance(event, TimesDoubted):
            self._uploader.widen_times(widened_times(event))
            self._stepped = event if event.jumped else self._stepped
        if isinstance(event, events.PhaseMoved):
            self._uploader.note_move(PhaseMove(local_ns=event.local_ns, shift_ns=event.shift_ns))
        self._happened.append({"local_ns": self._clock.now_ns(), **client_record(event)})
        if words := client_line(event):
            self._log.say(words)

    def _upload(self, picked: FramesSelected[CapturedFrame]) -> None:
        """Begin the upload of a burst, or continue it with further frames."""
        if picked.further:
            self._uploader.extend_burst(picked)
            return
        name, leader, burst = self.options.name, picked.trigger.leader, picked.trigger.burst
        facts, camera, streamed = self._camera.facts, self._camera.camera, picked.trigger.streamed
        # Without a clock of its own, a simulated camera shows true time.
        exact = SimulatedClock(0) if facts.kind == SIMULATED else None
        corrections, tolerance_ns = self._engine.aligner.corrections, self._engine.config.phase_tolerance_ns
        report = CameraReport(
            leader=leader,
            burst=burst,
            plan=CameraPlan(
                camera=camera_record(
                    name,
                    facts,
                    picked,
                    corrections,
                    tolerance_ns,
                    camera.device_clock,
                    self._camera.controls.held,
                    self._engine.delay_ns,
                ),
                reported=True,
                picking=streamed,
                calibration=camera.calibration,
                true_clock=self._clock if isinstance(self._clock, SimulatedClock) else exact,
            ),
            events=tuple(self._happened),
        )
        self._happened.clear()
        upload = Upload(
            report,
            streamed=streamed,
            with_truth=not picked.trigger.video,
            max_bytes=self.options.ring_bytes,
            on_commit=functools.partial(self._engine.forget_burst, leader, burst),
        )
        upload.extend(picked)
        stepped = self._stepped
        if stepped is not None and any(frame.local_ns <= stepped.until_local_ns for frame in picked.frames):
            first_ns = min(frame.local_ns for frame in picked.frames)
            upload.widen_times(replace(widened_times(stepped), from_local_ns=first_ns))
        self._uploader.add_burst(upload)


def camera_record(
    name: str,
    facts: CameraFacts,
    ready: FramesSelected[Any],
    corrections: int,
    tolerance_ns: int,
    device: DeviceClock | None = None,
    held: Mapping[Control, float] | None = None,
    delay_ns: int = 0,
) -> CameraRecord:
    """Return a camera's manifest record for a burst; `corrections` counts the phase corrections before it.

    `tolerance_ns` is the phase tolerance on the rig's grid; `device` is the camera's own clock, if it
    timestamps by one; `held` are the controls that a user set, `delay_ns` is its planned delay.
    """
    time_map, phase = ready.time_map, ready.phase
    return CameraRecord(
        name=name,
        facts=facts,
        held=dict(held) if held else msgspec.UNSET,
        delay_ns=delay_ns,
        clock=ClockRecord(
            epoch_local_ns=time_map.epoch_local_ns,
            offset_ns=time_map.offset_ns,
            skew_ppm=time_map.skew * 1e6,
            uncertainty_ns=round(time_map.uncertainty_ns),
            hard_bound_ns=round(time_map.hard_bound_ns),
            round_trip_ns=time_map.round_trip_ns,
            samples=time_map.samples,
            device_uncertainty_ns=None if device is None else device.uncertainty_ns,
            device_hard_bound_ns=None if device is None else device.hard_bound_ns,
        ),
        phase=None
        if phase is None
        else PhaseRecord(
            residual_ns=phase.error_ns,
            period_ns=round(phase.period_ns),
            drift_ppm=phase.drift_ppm,
            corrections=corrections,
            uncertainty_ns=round(1.96 * phase.sigma_ns),
            tolerance_ns=tolerance_ns,
        ),
    )


def widened_times(event: TimesDoubted) -> WidenedTimes:
    """Return the record of times that were found to be wrong, for a burst's manifest."""
    return WidenedTimes(
        from_local_ns=event.from_local_ns,
        until_local_ns=event.until_local_ns,
        uncertainty_ns=event.error_ns,
        hard_bound_ns=event.hard_bound_ns,
        reason=why_doubted(event),
    )
