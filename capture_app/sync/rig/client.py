"""The client's state machine: join, synchronize the clock, align the stream, save bursts; for ever."""

import random
from collections import deque
from typing import Generic, TypeVar

from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.estimator import FrameStamp, PhaseEstimate
from capture_app.sync.phase.goal import MAX_PERIOD_NS, MIN_PERIOD_NS
from capture_app.sync.rig.events import (
    ClientEvent,
    ClockSynced,
    FramesDropped,
    Joined,
    JoinRefused,
    LeaderLost,
)
from capture_app.sync.rig.membership import Membership
from capture_app.sync.rig.pending_bursts import PendingBursts
from capture_app.sync.rig.phase_loop import ClientConfig, Steering
from capture_app.sync.rig.timekeeper import BACKLOG_NS, FIRST_PACE_NS, NEAR_NS, PACE_NS, Timekeeper
from capture_app.sync.rig.trigger import RingBuffer, possible
from capture_app.sync.wire.beacon import Agreed, Beacon
from capture_app.sync.wire.camera_commands import CameraCommand
from capture_app.sync.wire.messages import (
    Control,
    Goodbye,
    Heartbeat,
    HeartbeatAck,
    Hello,
    NodeState,
    Refused,
    Report,
    TimeReply,
    Trigger,
    TriggerAck,
    Unknown,
    Welcome,
    WireError,
    decode,
    encode,
    root_of,
)

__all__ = ["BACKLOG_NS", "FIRST_PACE_NS", "NEAR_NS", "PACE_NS", "Client", "ClientConfig"]

F = TypeVar("F")

_MS = 1_000_000
_AT_ONCE_NS = -(2**62)
"""Before any time of any clock: a local clock may well be negative."""
HELLO_EVERY_NS = 500 * _MS
HELLOS = 3
"""Unanswered ones after which another leader is asked, where there is one."""
HEARTBEAT_EVERY_NS = 500 * _MS
LEADER_SILENT_NS = 2500 * _MS
HOLD_BEFORE_BURST_NS = 2000 * _MS
"""No correction of the phase is begun this long before a burst: its long frame would be in the burst."""


class Client(Generic[F]):
    """One camera's side of the protocol; `F` is whatever the node keeps of a frame.

    Feed it datagrams, frames and time (`now_ns`, the node's own clock); take datagrams, camera commands
    and events out. It never raises on what the network brings.
    """

    def __init__(self, config: ClientConfig, rng: random.Random) -> None:
        self.config = config
        self._steering = Steering(config, rng)
        self.aligner = self._steering.aligner
        self._timekeeper = Timekeeper(rng.getrandbits(32))
        self.clock = self._timekeeper.clock
        self.ring: RingBuffer[F] = RingBuffer(config.ring_frames)
        self.malformed = 0
        self.failure = ""
        self.hellos = 0
        """How often it has asked to join since it was last a member; HELLOS when its leader fell silent."""
        self.leader_is_alone = False
        """Whether the leader is a relay that has lost its own: it holds the time, and brings no bursts."""
        self._member: Membership | None = None
        self._leader: int | None = None
        self._root: int | None = None
        self._why_joining = ""
        self._hello_due_ns = _AT_ONCE_NS
        self._heartbeat_due_ns = _AT_ONCE_NS
        self._bursts: PendingBursts[F] = PendingBursts()
        self._last_member: Membership | None = None
        """What a leader that fell silent had told: its bursts are finished all the same."""
        self._outbox: deque[Control] = deque()
        self._events: deque[ClientEvent[F]] = deque()

    # What the outside sees

    @property
    def state(self) -> NodeState:
        """Where this client is on its way to taking pictures in step."""
        if self.failure:
            return NodeState.FAILED
        if self._member is None:
            return NodeState.JOINING
        if not self._timekeeper.synced:
            return NodeState.SYNCING
        return NodeState.READY if self._steering.ready else NodeState.ALIGNING

    @property
    def time_map(self) -> TimeMap | None:
        """The newest estimate of the leader's clock."""
        return self._timekeeper.time_map

    @property
    def own_map(self) -> TimeMap | None:
        """The same before anything was agreed with other clients: what the leader's answers alone tell."""
        return self._timekeeper.own_map

    def phase(self, local_ns: int) -> PhaseEstimate | None:
        """The stream's distance from the rig's grid at a local time in ns."""
        if self._member is None or self.time_map is None:
            return None
        return self._steering.phase(self._member, self.time_map, local_ns)

    def report(self, now_ns: int) -> Report:
        """What this client tells the leader about itself."""
        member = self._member
        why_no_centre = "" if member is None else member.why_no_centre
        alone = "its relay has lost the leader and holds the time over" if self.leader_is_alone else ""
        message = self.failure or self.aligner.problem or self._why_joining or alone or why_no_centre
        report = self._timekeeper.report(self.state, message, now_ns)
        return self._steering.report(report, member, self.phase(now_ns))

    # In

    def receive_datagram(self, data: bytes, now_ns: int) -> None:
        """Take in a datagram that arrived at `now_ns`; stamp it as near to the socket as can be."""
        try:
            message = decode(data)
        except WireError:
            self.malformed += 1
            return
        member = self._member
        match message:
            case TimeReply() if member is not None and message.client == member.client:
                if self._timekeeper.take_reply(message, now_ns):
                    member.heard_ns = now_ns
                self._note_clock(now_ns)
            case Welcome() if member is None and message.instance == self.config.instance:
                self._join(message, now_ns)
            case Refused() if member is None and message.instance == self.config.instance:
                self.hellos = 0 if message.soon else self.hellos
                if message.reason != self._why_joining:
                    self._why_joining = message.reason
                    self._events.append(JoinRefused(message.reason))
            case HeartbeatAck() if member is not None and message.client == member.client:
                member.heard_ns = now_ns
                if (message.leader, message.period_ns) != (member.leader, member.goal.period_ns):
                    self._leave("the leader has another grid of instants", now_ns)
                elif root_of(message) != self._root:
                    self._leave("the relay follows another leader", now_ns)
                else:
                    self._timekeeper.take_terms(message)
                    self.leader_is_alone = message.alone
                    if member.take_answer(message):
                        self._align(now_ns)
            case Agreed() if member is not None and message.client == member.client:
                member.heard_ns = now_ns
                self._timekeeper.listener.take(message)
            case Unknown() if member is not None and message.client == member.client:
                self._leave("the leader was restarted", now_ns)
            case Trigger() if member is not None and message.client == member.client:
                member.heard_ns = now_ns
                self._take_trigger(member, message)
            case _:
                pass

    def receive_broadcast(self, data: bytes, now_ns: int) -> None:
        """Take in a datagram of the group that the leader named; of those only its beacons count."""
        try:
            message = decode(data)
        except WireError:
            self.malformed += 1
            return
        if isinstance(message, Beacon) and self._member is not None and message.leader == self._member.leader:
            self._timekeeper.listener.hear(message.number, now_ns)

    def frame_arrived(self, stamp: FrameStamp, frame: F, now_ns: int) -> None:
        """Take in a frame in the order of the stream."""
        self.ring.add(stamp.timestamp_ns, frame)
        dropped = self.aligner.frame(stamp)
        if dropped:
            self._events.append(FramesDropped(dropped, stamp.sequence))
        self._finish_bursts(now_ns)
        self._align(now_ns)

    def stream_started(self, now_ns: int) -> None:
        """The camera was told to start at `now_ns`: at first, and after each RestartStream."""
        self.aligner.stream_started(now_ns)

    def fail(self, reason: str) -> None:
        """The camera failed; an empty reason means that it works again."""
        if bool(reason) != bool(self.failure):
            self._heartbeat_due_ns = _AT_ONCE_NS
        self.failure = reason

    @property
    def is_member(self) -> bool:
        """Whether a leader has taken this client in and is there."""
        return self._member is not None

    @property
    def may_change(self) -> bool:
        """Whether a change of the leader would disturb nothing now."""
        return self.state is NodeState.READY and not self._bursts

    def change_leader(self, reason: str, now_ns: int) -> None:
        """Follow another leader from now on: the next datagrams go to that one."""
        self._leave(reason, now_ns)
        self.hellos = 0

    def leave(self) -> None:
        """Say goodbye: this client is about to stop."""
        if self._member is not None:
            self._outbox.append(Goodbye(self._member.client))
            self._member = None

    def handle_timer(self, now_ns: int) -> None:
        """Do what is due; call it at `next_timer`, or any time."""
        member = self._member
        if member is None:
            if now_ns >= self._hello_due_ns:
                self.hellos += 1
                self._hello_due_ns = now_ns + HELLO_EVERY_NS
                self._outbox.append(Hello(self.config.name, self.config.instance, self.config.camera))
            return
        if now_ns - member.heard_ns >= LEADER_SILENT_NS:
            self._leave("the leader is silent", now_ns)
            self.hellos = HELLOS
            return
        self._timekeeper.handle_timer(now_ns)
        self._note_clock(now_ns)
        if now_ns >= self._heartbeat_due_ns:
            self._heartbeat_due_ns = now_ns + HEARTBEAT_EVERY_NS
            member.asked = self.aligner.settled
            self._outbox.append(Heartbeat(member.client, self.report(now_ns)))
        heard = self._timekeeper.heard(now_ns)
        if heard is not None:
            self._outbox.append(heard)
        self._finish_bursts(now_ns)

    # Out

    def next_timer(self) -> int:
        """Local time in ns at which `handle_timer` wants to be called."""
        member = self._member
        if member is None:
            return self._hello_due_ns
        silent_ns = member.heard_ns + LEADER_SILENT_NS
        return min(silent_ns, self._timekeeper.next_timer(), self._heartbeat_due_ns)

    def datagrams_to_send(self, now_ns: int) -> list[bytes]:
        """Return the datagrams for the leader; a time request carries `now_ns`, so send them at once."""
        datagrams = []
        request = None if self._member is None else self._timekeeper.request_to_send(now_ns)
        if request is not None:
            datagrams.append(request)
        while self._outbox:
            datagrams.append(encode(self._outbox.popleft()))
        return datagrams

    def next_command(self) -> CameraCommand | None:
        """Return the next command for the camera, None where there is none."""
        return self._steering.next_command()

    def next_event(self) -> "ClientEvent[F] | None":
        """Return the next thing that happened, None where there is none."""
        return self._events.popleft() if self._events else None

    # The parts

    def _join(self, welcome: Welcome, now_ns: int) -> None:
        if not MIN_PERIOD_NS <= welcome.period_ns <= MAX_PERIOD_NS:
            self.malformed += 1
            return
        if welcome.leader != self._leader:
            self._timekeeper.forget(same_root=root_of(welcome) == self._root)
            self._leader = welcome.leader
        if root_of(welcome) != self._root:
            # Bursts are the root's, in its time: another relay does not end them.
            self._bursts.forget()
            self._root = root_of(welcome)
        self.hellos = 0
        self.leader_is_alone = False
        self._member = Membership.begin(self.config.camera, welcome, now_ns)
        self._timekeeper.follow(welcome, now_ns)
        self._why_joining = ""
        self._heartbeat_due_ns = now_ns
        self._events.append(Joined(welcome.transfer_port, welcome.leader, welcome.beacons))

    def _leave(self, reason: str, now_ns: int) -> None:
        self._last_member, self._member = self._member, None
        self._timekeeper.stop()
        self._why_joining = reason
        self._hello_due_ns = now_ns
        self._events.append(LeaderLost(reason))

    def _note_clock(self, now_ns: int) -> None:
        while (event := self._timekeeper.next_event()) is not None:
            self._events.append(event)
            if isinstance(event, ClockSynced):
                self._heartbeat_due_ns = now_ns

    def _align(self, now_ns: int) -> None:
        member, time_map = self._member, self.time_map
        if member is None or time_map is None or not self._timekeeper.synced:
            return
        if self._steering.step(member, time_map, now_ns, burst_leader_ns=self._burst_near(now_ns, time_map)):
            self._heartbeat_due_ns = min(self._heartbeat_due_ns, now_ns)
        while (event := self._steering.next_event()) is not None:
            self._events.append(event)

    def _burst_near(self, now_ns: int, time_map: TimeMap) -> tuple[int, int] | None:
        return self._bursts.first_before(time_map.leader_from_local(now_ns + HOLD_BEFORE_BURST_NS))

    def _take_trigger(self, member: Membership, trigger: Trigger) -> None:
        refusal = ""
        if self.failure:
            refusal = self.failure
        elif not self._timekeeper.knows:
            refusal = "its clock is not synchronized yet"
        elif not possible(trigger.count, trigger.step_ns):
            refusal = f"a burst of {trigger.count} frames every {trigger.step_ns} ns is not possible"
        else:
            self._bursts.take(trigger)
        self._outbox.append(TriggerAck(member.client, trigger.leader, trigger.burst, refusal))

    def _finish_bursts(self, now_ns: int) -> None:
        member, time_map = self._member or self._last_member, self.time_map
        if member is None or time_map is None:
            return
        outlier_ns = self.aligner.outlier_ns
        self._events.extend(
            self._bursts.pick_due(
                self.ring, member, time_map, now_ns, outlier_ns=outlier_ns, phase=self.phase
            )
        )
