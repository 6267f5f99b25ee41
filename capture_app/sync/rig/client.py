"""State machine of a camera's client: joins, synchronizes its clock, aligns its stream, selects burst frames.

Accepted bursts stay pending until their frames are selected, even if their leader is lost.
"""

import random
from collections import deque
from collections.abc import Iterable, MutableSequence
from dataclasses import dataclass, replace
from math import hypot
from typing import Any, Generic

from msgspec import structs

from capture_app.common.bounds import CENTURY_NS, sendable
from capture_app.common.camera_facts import CameraFacts, PhaseControl
from capture_app.common.node_state import NodeState
from capture_app.common.text import duration
from capture_app.sync.clock.clock_filter import ClockSample, PathAsymmetry
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.actuators import InjectionProfile
from capture_app.sync.phase.aligner import Aligner
from capture_app.sync.phase.estimator import FrameStamp, PhaseEstimate
from capture_app.sync.phase.frame_grid import FrameGrid
from capture_app.sync.rig import status_text
from capture_app.sync.rig.burst_orders import CANCELLED
from capture_app.sync.rig.events import (
    AlignmentFailed,
    ForeignTrigger,
    FramesDropped,
    PhaseCorrected,
    PhaseMoved,
    TriggerCancelled,
)
from capture_app.sync.rig.frame_selection import (
    RING_BYTES,
    RING_NS,
    SLEPT,
    CameraGrid,
    F,
    FrameSelection,
    RingBuffer,
    is_possible_burst,
)
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.timekeeping.clock_events import TimesDoubted
from capture_app.sync.timekeeping.poll_schedule import AT_ONCE_NS, AccuracyTarget, SteadySchedule
from capture_app.sync.timekeeping.timekeeper import Timekeeper
from capture_app.sync.wire.camera_commands import CameraCommand
from capture_app.sync.wire.codec import Message
from capture_app.sync.wire.datagrams import HeartbeatAck, Report, Trigger, TriggerAck, Welcome, camera_key

HOLD_BEFORE_BURST_NS = 2_000_000_000
"""Time before a burst in which no phase correction begins: its long frame would be in the burst."""
CORRECTION_NS = 1_000_000_000
"""Time that a correction of a ready stream may take; one by frame injection takes 0.3 s (docs/paper.md)."""
SLEEP_ERROR_NS = 2_000_000_000
"""Maximum error of the length of a sleep: some machines read it from a clock of whole seconds."""
PHASE_TOLERANCE_NS, RESET_TOLERANCE_NS = 100_000, 2_000_000
"""Phase tolerances if none is requested: the second for cameras that can only restart their stream, as a
restart is uncertain by that much."""


@dataclass(frozen=True, slots=True)
class ClientConfig:
    """Configuration of a client; times in ns."""

    name: str
    instance: int
    camera: CameraFacts
    tolerance_ns: int | None = None
    """Requested tolerance of the phase; None for the default of the camera's kind."""
    ring_ns: int = RING_NS
    """Time for which frames stay in the ring buffer, where a burst in the past can select them."""
    ring_bytes: int = RING_BYTES
    """Maximum memory of the ring buffer, in bytes."""
    injection_profile: InjectionProfile | None = None
    """Known effect of a long frame on this camera, from earlier runs."""
    start_latencies_ns: tuple[int, ...] = ()
    """Measured delays from start command to first frame of this camera, newest last."""
    clock_tolerance_ns: int | None = None
    """Requested accuracy of the clock; None for what the link can bear, at least the phase's tolerance."""
    moves_in_recordings: bool = False
    """Whether a recorded stream that drifts is brought back by one longer frame."""

    @property
    def phase_tolerance_ns(self) -> int:
        """Phase errors up to this are left alone."""
        only_restarts = self.camera.phase_control == PhaseControl.RESET
        return self.tolerance_ns or (RESET_TOLERANCE_NS if only_restarts else PHASE_TOLERANCE_NS)


class Client(TimeClient, Generic[F]):
    """Camera side of the protocol; `F` is the node's type of a frame.

    In addition to a `TimeClient`, the caller passes in frames, and takes out camera commands and every
    `ClientEvent[F]`.
    """

    def __init__(
        self,
        config: ClientConfig,
        rng: random.Random,
        schedule: SteadySchedule | None = None,
        *,
        samples: MutableSequence[ClockSample] | None = None,
    ) -> None:
        """`schedule` decides when to send time requests; the default is `SteadySchedule`.

        Every exchange with the leader is appended to `samples`.
        """
        asked_ns = config.clock_tolerance_ns
        target = AccuracyTarget(asked_ns, min_ns=config.phase_tolerance_ns if asked_ns is None else None)
        keeper = Timekeeper(rng.getrandbits(32), schedule, samples=samples, target=target)
        super().__init__(config.name, config.instance, keeper, config.camera)
        self.config = config
        self.aligner = Aligner(
            config.camera, tolerance_ns=config.phase_tolerance_ns, rng=rng, profile=config.injection_profile
        )
        for latency_ns in config.start_latencies_ns:
            self.aligner.learn_start_latency(latency_ns)
        self._reported_problem = ""
        self._aligned_ns = AT_ONCE_NS
        self._corrects_briefly = False
        """Whether a ready stream is not aligned for a moment, as it drifted or its clock is known better."""
        self._reported = self._answered = False
        """Whether the current phase was reported to the leader, and whether the leader has answered since."""
        self._commands: deque[CameraCommand] = deque()
        self.ring: RingBuffer[F] = RingBuffer(config.ring_ns, config.ring_bytes)
        self.failure = ""
        self.upload_problem = ""
        """Why no stream for the images reaches the leader; empty while one does."""
        self.delay_ns = 0
        """Planned time of this camera's frames after the rig's instants, in a staggered rig."""
        self._root: int | None = None
        self._foreign_leader: int | None = None
        self._bursts: FrameSelection[F] = FrameSelection()
        self._earlier: list[tuple[FrameSelection[F], CameraGrid, TimeMap]] = []
        """Bursts of lost leaders that go on to their ordered end, with the grid and the time in holdover."""
        # Unlike a clock's events, frames must not be lost if there are many.
        self._events = keeper.events = deque[Any]()

    def add_path_asymmetry(self, measured: PathAsymmetry) -> PathAsymmetry:
        """Add an asymmetry that was measured on top of the path's known one; return the sum.

        The measurement is of the clock's error, so its uncertainty includes that of the clock.
        """
        clock = self.timekeeper.clock
        clock.asymmetry = replace(
            measured,
            late_ns=measured.late_ns + clock.late_ns,
            uncertainty_ns=hypot(measured.uncertainty_ns, clock.chance_ns),
        )
        return clock.asymmetry

    # What the outside sees

    @property
    def state(self) -> NodeState:
        """State of this client: joining, syncing, aligning, degraded, ready or failed."""
        if self.failure:
            return NodeState.FAILED
        state = super().state
        if state is not NodeState.READY:
            return state
        if not self._is_aligned and not self._corrects_briefly:
            return NodeState.ALIGNING
        fine = self.timekeeper.target.met and not self.aligner.window.degradation
        return state if fine else NodeState.DEGRADED

    def phase(self, local_ns: int) -> PhaseEstimate | None:
        """Return the stream's phase error and drift at a local time in ns; None while unknown."""
        grid = self._grid
        if not self.is_member or grid is None or self.time_map is None:
            return None
        return self.aligner.estimate(
            self.time_map, grid.grid_of_stamps, self.time_map.leader_from_local(local_ns)
        )

    def instant_of(self, stamp_ns: int) -> tuple[int, FrameGrid, int] | None:
        """Return which instant of the rig's grid a frame shows, by its timestamp, and how late it is, in ns.

        By the current map; None while that or the grid is unknown.
        """
        grid = self._grid
        if not self.is_member or grid is None or self.time_map is None:
            return None
        stamps, leader_ns = grid.grid_of_stamps, self.time_map.leader_from_local(stamp_ns)
        return stamps.index_of(leader_ns), grid.rig_grid, stamps.phase_error(leader_ns)

    @property
    def has_burst_pending(self) -> bool:
        """Whether frames of a burst are still to be selected."""
        return bool(self._bursts) or bool(self._earlier)

    def report(self, now_ns: int) -> Report:
        """Return the report of this client for its leader."""
        grid = self._grid if self.is_member else None
        phase, why_no_centre = self.phase(now_ns), "" if grid is None else grid.why_no_centre
        holdover = "its relay has lost the leader and is in holdover" if self.leader_in_holdover else ""
        known = self.failure or self.aligner.problem or self.why_joining or holdover or self.upload_problem
        state = status_text.of_state(
            self.state,
            self.timekeeper,
            self.aligner,
            phase,
            now_ns,
            can_move=self._can_move,
            waits=grid is not None and self._waits_for_others(grid),
        )
        report = structs.replace(
            self.timekeeper.report(self.state, known or state or why_no_centre, now_ns),
            corrections=self.aligner.corrections,
            frames=self.aligner.phase.frames,
            drops=self.aligner.phase.drops,
            tolerance_ns=self.aligner.window.tolerance_ns,
            stamp_quantum_ns=round(self.aligner.phase.quantum_ns),
            uploads_wait=bool(self.upload_problem),
        )
        if phase is None or grid is None:
            return report
        frame_leader_ns = grid.rig_grid.instant(grid.rig_grid.index_of(phase.at_leader_ns)) + phase.error_ns
        return structs.replace(
            report,
            phase_error_ns=phase.error_ns,
            period_ns=phase.period_ns,
            drift_ppm=phase.drift_ppm,
            frame_leader_ns=sendable(frame_leader_ns, CENTURY_NS) if self.aligner.settled else None,
        )

    @property
    def leader_in_holdover(self) -> bool:
        """Whether the leader is a relay in holdover: it keeps the time, but forwards no bursts."""
        return self.is_member and self.followed is not None and self.followed.in_holdover

    # In

    def receive_message(self, message: Message, now_ns: int) -> None:
        """Process a message of the leader that arrived at `now_ns`."""
        super().receive_message(message, now_ns)
        if self.followed is not None and self.followed.delays_ns is not None and not self.has_burst_pending:
            self.delay_ns = self.followed.delays_ns.get(camera_key(self.name), 0)
        match message:
            case HeartbeatAck() if self.is_addressed(message) and self._reported and not self._answered:
                # The leader's grid takes this phase into account from now on, so the stream may be moved.
                self._answered = True
                self._align(now_ns)
            case Trigger() if self.is_addressed(message):
                if (message.root or message.leader) == self._root:
                    self._take_trigger(message)
                elif message.leader != self._foreign_leader:
                    # Of a leader that is not followed, the first trigger is reported.
                    self._foreign_leader = message.leader
                    self._events.append(ForeignTrigger(message.leader, message.burst))

    def frames_arrived(self, frames: Iterable[tuple[FrameStamp, F, int]], now_ns: int) -> None:
        """Store the next frames of the stream, each with its bytes of memory, and select what is due."""
        for stamp, frame, size_bytes in frames:
            self.ring.add(stamp.timestamp_ns, frame, size_bytes)
            if dropped := self.aligner.add_frame(stamp):
                self._events.append(FramesDropped(dropped, stamp.sequence))
        self._finish_bursts(now_ns)
        self._align(now_ns)

    def stream_started(self, now_ns: int) -> None:
        """Note that the camera was commanded to start at `now_ns`: first start or RestartStream."""
        self.aligner.note_stream_start(now_ns)

    def wake_up(self, slept_ns: int, now_ns: int) -> None:
        """Start over after the machine slept for about `slept_ns`, in which its clock stood still or ran on.

        Selected frames keep their times; the others from before the sleep have none any more.
        """
        if (newest_ns := self.ring.newest_local_ns) is not None:
            self._finish_bursts(newest_ns, is_last=True)
        for bursts, _, _ in self._earlier:
            self._events.extend(bursts.keep_ordered(has_time=False))
        self._earlier.clear()
        self._bursts.keep_times()
        self.ring.clear_after_sleep(now_ns)
        self.timekeeper.forget()
        # Later frames are off the clock record of their burst by so much.
        off_ns = slept_ns + SLEEP_ERROR_NS
        self._events.append(TimesDoubted(now_ns, now_ns, off_ns, off_ns, jumped=True))
        self.lose(f"{SLEPT} for {duration(slept_ns)}", now_ns)

    def fail(self, reason: str) -> None:
        """Note that the camera failed; an empty reason means that it works again."""
        if bool(reason) != bool(self.failure):
            self.report_at_once()
        self.failure = reason

    def follow(self, welcome: Welcome, now_ns: int) -> bool:
        """Become a member of the leader that sent this welcome; return False if it cannot be followed."""
        grid, time_map = self._grid, self.time_map
        if is_followed := super().follow(welcome, now_ns):
            # Another leader does not know the phase yet.
            self._reported = self._answered = False
            if welcome.config.path[0] != self._root:
                # Bursts belong to the root and use its time: another relay of the root changes nothing.
                self._events.extend(self._bursts.keep_ordered(has_time=time_map is not None))
                if self._bursts and grid is not None and time_map is not None:
                    self._earlier.append((self._bursts, grid, time_map))
                self._bursts, self._root = FrameSelection(self._bursts), welcome.config.path[0]
        return is_followed

    def change_leader(self, reason: str, now_ns: int) -> None:
        """Leave the current leader; the next datagrams are for another one."""
        self.lose(reason, now_ns)
        self.hellos = 0

    def forget_burst(self, leader: int, burst: int) -> None:
        """Stop selecting frames of a burst: its leader has what it needs, or has cancelled it."""
        for bursts in (self._bursts, *(earlier[0] for earlier in self._earlier)):
            bursts.forget(leader, burst)

    def handle_timer(self, now_ns: int) -> None:
        """Do everything that is due; call it at `next_timer`, or at any other time."""
        super().handle_timer(now_ns)
        self._finish_bursts(now_ns)

    # Out

    def next_command(self) -> CameraCommand | None:
        """Return the next command for the camera, or None."""
        return self._commands.popleft() if self._commands else None

    # The parts

    @property
    def _grid(self) -> CameraGrid | None:
        """Grid of the current leader, or of the last one, whose bursts may still be pending."""
        config = self.followed
        return (
            None
            if config is None
            else CameraGrid.of_camera(self.camera, config, self.aligner.phase, self.delay_ns)
        )

    @property
    def _can_move(self) -> bool:
        return self.camera.phase_control != PhaseControl.NONE and not self.aligner.other_rate

    @property
    def _is_aligned(self) -> bool:
        """Whether the stream is aligned as well as possible, or will be by the time of a burst."""
        aligner = self.aligner
        return (
            aligner.window.within_window or aligner.meets_bursts or (aligner.settled and not self._can_move)
        )

    def _waits_for_others(self, grid: CameraGrid) -> bool:
        """Whether the stream must not be moved yet: a restart waits for a time that suits all cameras."""
        if self.camera.phase_control != PhaseControl.RESET:
            return False
        return not self._answered or grid.common_instant_leader_ns is None

    def _report_to_leader(self, now_ns: int) -> Report:
        self._reported = self.aligner.settled
        return super()._report_to_leader(now_ns)

    def _align(self, now_ns: int) -> None:
        """Queue the command that the stream needs, and report to the leader at once where it matters."""
        grid, time_map, aligner = self._grid, self.time_map, self.aligner
        if grid is None or time_map is None or super().state is not NodeState.READY:
            aligner.window.clear()
            self._corrects_briefly = False
            return
        was_aligned, corrections = self._is_aligned, aligner.corrections
        before = aligner.estimate(time_map, grid.grid_of_stamps, time_map.leader_from_local(now_ns))
        if (shift_ns := aligner.complete_command(now_ns)) and self.has_burst_pending:
            self._events.append(PhaseMoved(aligner.phase.run_begun_ns, shift_ns))
        if not aligner.settled:
            self._reported = self._answered = False
        is_new = aligner.settled and not self._reported
        command = aligner.next_command(
            time_map,
            grid.grid_of_stamps,
            now_ns,
            hold=bool(self._earlier) or self._waits_for_others(grid),
            burst_leader_ns=self._bursts.first_before(
                time_map.leader_from_local(now_ns + HOLD_BEFORE_BURST_NS)
            ),
            is_recording=self.config.moves_in_recordings and self._bursts.is_recording(grid.rig_grid),
            common_instant_leader_ns=grid.common_instant_leader_ns,
        )
        if command is not None:
            self._commands.append(command)
            if aligner.corrections > corrections:
                self._events.append(PhaseCorrected(command, before))
                is_new = True
        if aligner.problem != self._reported_problem:
            self._reported_problem = aligner.problem
            if aligner.problem:
                self._events.append(AlignmentFailed(aligner.problem))
        is_near = before is None or abs(before.error_ns) <= 2.0 * aligner.window.tolerance_ns
        self._aligned_ns = now_ns if self._is_aligned else self._aligned_ns
        self._corrects_briefly = is_near and now_ns - self._aligned_ns < CORRECTION_NS
        if is_new or was_aligned is not self._is_aligned:
            self.report_at_once()

    def _take_trigger(self, trigger: Trigger) -> None:
        refusal = ""
        if not trigger.count:
            refusal = CANCELLED
            self.forget_burst(trigger.leader, trigger.burst)
            self._events.append(TriggerCancelled(trigger.leader, trigger.burst))
        elif self.failure:
            refusal = self.failure
        elif not self.timekeeper.time_is_known:
            refusal = "its clock is not synchronized yet"
        elif not is_possible_burst(trigger.count, trigger.step_ns, streamed=trigger.streamed):
            refusal = f"a burst of {trigger.count} frames every {trigger.step_ns} ns is not possible"
        else:
            # What an earlier run of the leader ordered may go on by that run's time.
            key = trigger.leader, trigger.burst
            (next((bursts[0] for bursts in self._earlier if key in bursts[0]), self._bursts)).add(trigger)
        self._outbox.append(TriggerAck(trigger.client, trigger.leader, trigger.burst, refusal))

    def _finish_bursts(self, now_ns: int, *, is_last: bool = False) -> None:
        """Select the frames that are due; of a stream whose newest frame `is_last`, up to that one."""
        is_last |= bool(self.failure)
        grid, time_map = self._grid, self.time_map
        for bursts, held_grid, held_map in self._earlier:
            if time_map is not None and held_map.agrees_with(time_map, now_ns):
                # The leader was restarted on the same machine, or another one continues its time.
                self._bursts.take_over(bursts)
            self._select(bursts, held_grid, held_map, now_ns, is_last=is_last)
        self._earlier = [earlier for earlier in self._earlier if earlier[0]]
        if grid is not None and time_map is not None:
            self._select(self._bursts, grid, time_map, now_ns, is_last=is_last)

    def _select(
        self, bursts: FrameSelection[F], grid: CameraGrid, time_map: TimeMap, now_ns: int, *, is_last: bool
    ) -> None:
        self._events.extend(
            bursts.select_due(
                self.ring,
                self.aligner,
                grid,
                time_map,
                now_ns,
                is_member=self.is_member,
                is_last=is_last,
            )
        )
