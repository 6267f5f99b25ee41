"""The client's state machine: join, synchronize the clock, align the stream, pick the frames of bursts.

Bursts that it has accepted wait until their frames are picked, whether their leader lives or not.
"""

import random
from collections import deque
from collections.abc import MutableSequence
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

from msgspec import structs

from capture_app.camera_facts import CameraFacts
from capture_app.sync.clock.clock_filter import ClockSample
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.stamps import FrameStamp, PhaseEstimate
from capture_app.sync.rig import node_message
from capture_app.sync.rig.events import BurstCancelled, ClientEvent, FramesDropped, Joined, StrangeTrigger
from capture_app.sync.rig.frame_selection import (
    NO_FRAME_OF_ITS_OWN,
    CameraGrid,
    FramesSelected,
    Gap,
    RingBuffer,
    SelectedFrame,
    is_possible_burst,
)
from capture_app.sync.rig.orders import CANCELLED
from capture_app.sync.rig.phase_loop import ClientConfig, PhaseLoop
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.timekeeping.poll_schedule import AccuracyTarget, PollSchedule
from capture_app.sync.timekeeping.timekeeper import Timekeeper
from capture_app.sync.wire.camera_commands import CameraCommand
from capture_app.sync.wire.messages import HeartbeatAck, NodeState, Report, Trigger, TriggerAck

F = TypeVar("F")

HOLD_BEFORE_BURST_NS = 2_000_000_000
"""No correction of the phase is begun this long before a burst: its long frame would be in the burst."""


PATIENCE_PERIODS = 30
"""How long after an instant a camera without frames is waited for."""
PAUSE_NS = 5_000_000_000
"""Between two instants that are so far apart a stream may be moved."""


@dataclass(slots=True)
class _PendingBurst(Generic[F]):
    """A burst whose frames are set aside as they come: the ring buffer may not reach back to the first."""

    trigger: Trigger
    picked: list[SelectedFrame[F] | Gap] = field(default_factory=list)
    """Selected frames and gaps that are not told yet."""
    told: int = 0
    """How many instants have been told."""
    time_map: TimeMap | None = None
    """The map by which they were told: one burst has one map, but for one that is streamed."""
    last_stamp_ns: int | None = None
    """Timestamp of the last frame that was selected."""

    @property
    def over(self) -> int:
        """How many instants are over."""
        return self.told + len(self.picked)

    @property
    def has_news(self) -> bool:
        """Whether there is something to tell.

        Spare instants are told one by one, those before together; of a burst that is streamed each by itself.
        """
        if self.trigger.streamed:
            return bool(self.picked) or self.over >= self.trigger.count
        return bool(self.picked) and self.over >= self.trigger.count - self.trigger.spare

    @property
    def span_ns(self) -> tuple[int, int]:
        """Leader times between which the stream should not be moved, in ns."""
        if self.trigger.streamed and self.trigger.step_ns >= PAUSE_NS:
            return self.instant_ns(self.over), self.instant_ns(self.over)
        return self.instant_ns(0), self.instant_ns(self.trigger.count - 1)

    def instant_ns(self, instant: int) -> int:
        """Leader time in ns."""
        return self.trigger.first_leader_ns + instant * self.trigger.step_ns

    def once(self, picked: SelectedFrame[F] | Gap) -> SelectedFrame[F] | Gap:
        """The same, but a gap where its frame is that of the instant before: one further away is none."""
        if isinstance(picked, Gap):
            return picked
        if picked.stamp_ns == self.last_stamp_ns:
            return Gap(picked.instant, NO_FRAME_OF_ITS_OWN)
        self.last_stamp_ns = picked.stamp_ns
        return picked

    def tell(
        self, picks: tuple[SelectedFrame[F], ...], time_map: TimeMap, phase: PhaseEstimate | None
    ) -> FramesSelected[F]:
        """What is new of it: the picks with their times by this map, and what is a gap."""
        trigger, further = self.trigger, self.told > 0
        gaps = tuple(gap for gap in self.picked if isinstance(gap, Gap))
        self.told, self.time_map = self.over, time_map
        self.picked.clear()
        streamed = trigger if trigger.streamed else None
        return FramesSelected(
            trigger.leader, trigger.burst, picks, gaps, time_map, phase, further, streamed, self.told
        )


class PendingBursts(Generic[F]):
    """Triggers of one tree's root, by its run and their number, whichever relay has brought them."""

    def __init__(self) -> None:
        self._pending: dict[tuple[int, int], _PendingBurst[F]] = {}
        self._done: deque[tuple[int, int]] = deque(maxlen=64)

    def __bool__(self) -> bool:
        """Whether any burst is still to be picked."""
        return bool(self._pending)

    def clear(self) -> list[FramesSelected[F]]:
        """Forget all bursts, as those of another root are in another time; return how those under way end."""
        ends = []
        for burst in self._pending.values():
            if burst.trigger.streamed and burst.time_map is not None:
                burst.trigger = structs.replace(burst.trigger, count=burst.told)
                burst.picked.clear()
                ends.append(burst.tell((), burst.time_map, None))
        self._pending.clear()
        self._done.clear()
        return ends

    def add(self, trigger: Trigger) -> None:
        """Add a burst; a trigger that comes again can only end one that is streamed earlier."""
        key = trigger.leader, trigger.burst
        if key in self._done:
            return
        known = self._pending.setdefault(key, _PendingBurst(trigger))
        if known.trigger.streamed and trigger.count < known.trigger.count:
            known.trigger = structs.replace(known.trigger, count=max(trigger.count, known.over))

    def forget(self, leader: int, burst: int) -> None:
        """Select nothing more of a burst, also should its trigger come again."""
        self._pending.pop((leader, burst), None)
        if (leader, burst) not in self._done:
            self._done.append((leader, burst))

    def first_before(self, leader_ns: int) -> tuple[int, int] | None:
        """First and last instant of the earliest burst that has begun, or does before a leader time in ns.

        Of one with long pauses it is the next instant alone: between two of them the stream may be moved.
        """
        spans = [burst.span_ns for burst in self._pending.values() if burst.over < burst.trigger.count]
        return min((span for span in spans if span[0] <= leader_ns), default=None)

    def select_due(
        self,
        ring: RingBuffer[F],
        loop: PhaseLoop,
        grid: CameraGrid,
        time_map: TimeMap,
        now_ns: int,
        *,
        is_member: bool,
    ) -> list[FramesSelected[F]]:
        """Select the frames of all bursts whose last frame is there, or waited for no longer.

        Spare instants are told after that, each when it is over; the stream's phase only by a member.
        """
        due = []
        for key, burst in list(self._pending.items()):
            for instant in range(burst.over, burst.trigger.count):
                instant_ns = burst.instant_ns(instant)
                if not _is_over(instant_ns, ring, grid, time_map, now_ns):
                    break
                burst.picked.append(burst.once(grid.select(ring, time_map, instant, instant_ns)))
            if burst.has_news:
                newest = burst.trigger.streamed or burst.time_map is None
                by = time_map if newest else burst.time_map or time_map
                last_ns = grid.wanted_ns(by, burst.instant_ns(max(0, burst.over - 1)))
                phase = loop.phase(grid, time_map, last_ns) if is_member else None
                picks = (
                    grid.pick(by, pick.frame, pick.stamp_ns, pick.instant, burst.instant_ns(pick.instant))
                    for pick in burst.picked
                    if isinstance(pick, SelectedFrame)
                )
                due.append(burst.tell(tuple(picks), by, phase))
            if burst.told == burst.trigger.count:
                self.forget(*key)
        return due


def _is_over(at_ns: int, ring: RingBuffer[F], grid: CameraGrid, time_map: TimeMap, now_ns: int) -> bool:
    """Whether the frame of an instant of leader time has come, or is waited for no longer."""
    newest_ns, period_ns = ring.newest_local_ns, grid.rig_grid.period_ns
    wanted_ns = grid.wanted_ns(time_map, at_ns)
    seen = newest_ns is not None and newest_ns > wanted_ns + period_ns // 2
    return seen or now_ns >= wanted_ns + PATIENCE_PERIODS * period_ns


class Client(Generic[F]):
    """One camera's side of the protocol; `F` is whatever the node keeps of a frame.

    Feed it datagrams, frames and time (`now_ns`, the node's own clock); take datagrams, camera commands
    and events out. It never raises on what the network brings.
    """

    def __init__(
        self,
        config: ClientConfig,
        rng: random.Random,
        schedule: PollSchedule | None = None,
        *,
        samples: MutableSequence[ClockSample] | None = None,
    ) -> None:
        """`schedule` says when it asks for the time; the default is that of `SteadySchedule`.

        Every exchange with the leader is added to `samples`.
        """
        self.config = config
        self._phase_loop = PhaseLoop(config, rng)
        self.aligner = self._phase_loop.aligner
        self.time = TimeClient(
            config.name,
            config.instance,
            Timekeeper(
                rng.getrandbits(32),
                schedule,
                samples=samples,
                target=AccuracyTarget(config.tolerance_ns),
            ),
            config.camera,
            report=self._report_to_leader,
        )
        """Its membership and its clock."""
        self.ring: RingBuffer[F] = RingBuffer(config.ring_ns, config.ring_bytes)
        self.failure = ""
        self.strange_triggers = 0
        """How many triggers came of a leader that is not the one that is followed."""
        self._root: int | None = None
        self._stranger: int | None = None
        self._bursts: PendingBursts[F] = PendingBursts()
        self._events: deque[ClientEvent[F]] = deque()

    def update_camera(self, camera: CameraFacts) -> None:
        """Note that the camera exposes otherwise now, or is known better: what is aligned follows."""
        self.config = replace(self.config, camera=camera)
        self.time.introduce_again(camera)

    # What the outside sees

    @property
    def state(self) -> NodeState:
        """How far this client is: joining, syncing, aligning, coarse, ready or failed."""
        if self.failure:
            return NodeState.FAILED
        state = self.time.state
        if state is not NodeState.READY:
            return state
        if not self._phase_loop.ready:
            return NodeState.ALIGNING
        fine = self.time.timekeeper.target.met and not self.aligner.window.coarseness
        return state if fine else NodeState.COARSE

    @property
    def time_map(self) -> TimeMap | None:
        """The newest estimate of the leader's clock."""
        return self.time.time_map

    def phase(self, local_ns: int) -> PhaseEstimate | None:
        """The stream's phase error and drift at a local time in ns; None while they are not known."""
        grid = self._grid
        if not self.time.is_member or grid is None or self.time_map is None:
            return None
        return self._phase_loop.phase(grid, self.time_map, local_ns)

    def phase_error_ns(self, stamp_ns: int) -> int | None:
        """How far a frame of that timestamp is from the rig's grid, by the present map; None if not known."""
        grid = self._grid
        if not self.time.is_member or grid is None or self.time_map is None:
            return None
        return grid.grid_of_stamps.phase_error(self.time_map.leader_from_local(stamp_ns))

    @property
    def has_burst_pending(self) -> bool:
        """Whether frames of a burst are still to be picked."""
        return bool(self._bursts)

    def report(self, now_ns: int) -> Report:
        """Return what this client tells the leader about itself."""
        grid = self._grid if self.time.is_member else None
        phase, why_no_centre = self.phase(now_ns), "" if grid is None else grid.why_no_centre
        holdover = "its relay has lost the leader and is in holdover" if self.leader_in_holdover else ""
        known = self.failure or self.aligner.problem or self.time.why_joining or holdover
        state = node_message.of_state(self.state, self.time.timekeeper, self._phase_loop, grid, phase, now_ns)
        message = known or state or why_no_centre
        report = self.time.timekeeper.report(self.state, message, now_ns)
        return self._phase_loop.report(report, grid, phase)

    @property
    def leader_in_holdover(self) -> bool:
        """Whether the leader is a relay in holdover: it keeps the time, but brings no bursts."""
        return self.time.is_member and self.time.followed is not None and self.time.followed.in_holdover

    @property
    def can_change_leader(self) -> bool:
        """Whether the leader may be changed now: the client is ready and no burst is pending."""
        return self.state in (NodeState.READY, NodeState.COARSE) and not self._bursts

    # In

    def receive_datagram(self, data: bytes, now_ns: int) -> None:
        """Take in a datagram that arrived at `now_ns`; stamp it as near to the socket as can be."""
        message = self.time.decode(data)
        if message is None:
            return
        self.time.receive_message(message, now_ns)
        self._note_events()
        match message:
            case HeartbeatAck() if self.time.is_addressed(message) and self._phase_loop.note_answer():
                self._align(now_ns)
            case Trigger() if self.time.is_addressed(message):
                if message.leader == self._root:
                    self._take_trigger(message)
                else:
                    self._note_strange_trigger(message)
            case _:
                pass

    def receive_broadcast(self, data: bytes, now_ns: int) -> None:
        """Take in a datagram of the group that the leader named; of those only its beacons count."""
        self.time.receive_broadcast(data, now_ns)

    def frame_arrived(self, stamp: FrameStamp, frame: F, now_ns: int, size_bytes: int = 0) -> None:
        """Take in the next frame of the stream, and how much memory it takes."""
        self.ring.add(stamp.timestamp_ns, frame, size_bytes)
        dropped = self.aligner.add_frame(stamp)
        if dropped:
            self._events.append(FramesDropped(dropped, stamp.sequence))
        self._finish_bursts(now_ns)
        self._align(now_ns)

    def stream_started(self, now_ns: int) -> None:
        """Note that the camera was told to start at `now_ns`: at first, and for each RestartStream."""
        self.aligner.note_stream_start(now_ns)

    def fail(self, reason: str) -> None:
        """Note that the camera failed; an empty reason means that it works again."""
        if bool(reason) != bool(self.failure):
            self.time.report_at_once()
        self.failure = reason

    def change_leader(self, reason: str, now_ns: int) -> None:
        """Leave the present leader; the next datagrams are for another one."""
        self.time.lose(reason, now_ns)
        self.time.hellos = 0
        self._note_events()

    def forget_burst(self, leader: int, burst: int) -> None:
        """Select no more frames of a burst: its leader has what it needs, or has cancelled it."""
        self._bursts.forget(leader, burst)

    def leave(self) -> None:
        """Say goodbye: this client is about to stop."""
        self.time.leave()

    def handle_timer(self, now_ns: int) -> None:
        """Do what is due; call it at `next_timer`, or any time."""
        self.time.handle_timer(now_ns)
        self._note_events()
        self._finish_bursts(now_ns)

    # Out

    def next_timer(self) -> int:
        """Local time in ns at which `handle_timer` wants to be called."""
        return self.time.next_timer()

    def datagrams_to_send(self, now_ns: int) -> list[bytes]:
        """Return the datagrams for the leader; a time request carries `now_ns`, so send them at once."""
        return self.time.datagrams_to_send(now_ns)

    def next_command(self) -> CameraCommand | None:
        """Return the next command for the camera, None where there is none."""
        commands = self._phase_loop.commands
        return commands.popleft() if commands else None

    def next_event(self) -> "ClientEvent[F] | None":
        """Return the next thing that happened, None where there is none."""
        return self._events.popleft() if self._events else None

    # The parts

    @property
    def _grid(self) -> CameraGrid | None:
        """By the configuration of the present leader, or of the last one, whose bursts are still picked."""
        config = self.time.followed
        return (
            None if config is None else CameraGrid.of_camera(self.config.camera, config, self.aligner.phase)
        )

    def _report_to_leader(self, now_ns: int) -> Report:
        self._phase_loop.note_report()
        return self.report(now_ns)

    def _note_events(self) -> None:
        while (event := self.time.next_event()) is not None:
            self._events.append(event)
            if isinstance(event, Joined) and self.time.followed is not None:
                self._phase_loop.note_join()
                if self.time.followed.path[0] != self._root:
                    # Bursts are the root's, in its time: another relay does not end them.
                    self._events.extend(self._bursts.clear())
                    self._root = self.time.followed.path[0]

    def _align(self, now_ns: int) -> None:
        grid, time_map = self._grid, self.time_map
        if grid is None or time_map is None or self.time.state is not NodeState.READY:
            self.aligner.window.clear()
            return
        burst_ns = self._bursts.first_before(time_map.leader_from_local(now_ns + HOLD_BEFORE_BURST_NS))
        if self._phase_loop.step(grid, time_map, now_ns, burst_leader_ns=burst_ns):
            self.time.report_at_once()
        self._events.extend(self._phase_loop.events)
        self._phase_loop.events.clear()

    def _note_strange_trigger(self, trigger: Trigger) -> None:
        """Let a trigger of a leader that is not followed be, and tell the first of each such leader."""
        self.strange_triggers += 1
        if trigger.leader != self._stranger:
            self._stranger = trigger.leader
            self._events.append(StrangeTrigger(trigger.leader, trigger.burst))

    def _take_trigger(self, trigger: Trigger) -> None:
        refusal = ""
        if not trigger.count:
            refusal = CANCELLED
            self.forget_burst(trigger.leader, trigger.burst)
            self._events.append(BurstCancelled(trigger.leader, trigger.burst))
        elif self.failure:
            refusal = self.failure
        elif not self.time.timekeeper.time_is_known:
            refusal = "its clock is not synchronized yet"
        elif not is_possible_burst(trigger.count, trigger.step_ns, streamed=trigger.streamed):
            refusal = f"a burst of {trigger.count} frames every {trigger.step_ns} ns is not possible"
        else:
            self._bursts.add(trigger)
        self.time.send(TriggerAck(trigger.client, trigger.leader, trigger.burst, refusal))

    def _finish_bursts(self, now_ns: int) -> None:
        grid, time_map = self._grid, self.time_map
        if grid is None or time_map is None:
            return
        self._events.extend(
            self._bursts.select_due(
                self.ring, self._phase_loop, grid, time_map, now_ns, is_member=self.time.is_member
            )
        )
