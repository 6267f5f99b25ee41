"""Camera-independent node side of the protocol: joins a leader, keeps its time, detects its loss."""

import random
from collections import deque
from typing import Any

from msgspec import structs

from capture_app.common.camera_facts import CameraFacts
from capture_app.common.node_state import WITHOUT_CAMERA, NodeState
from capture_app.common.timeouts import LEADER_SILENT_NS
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.rig.events import Joined, LeaderNotice
from capture_app.sync.timekeeping.clock_events import ClockEvent
from capture_app.sync.timekeeping.poll_schedule import AT_ONCE_NS, NEVER_NS
from capture_app.sync.timekeeping.timekeeper import Timekeeper
from capture_app.sync.wire.codec import (
    Message,
    WireError,
    decode,
    encode,
    version_mismatch,
)
from capture_app.sync.wire.datagrams import (
    CLOCK,
    MAX_DEPTH,
    ControlMessage,
    Goodbye,
    Heartbeat,
    HeartbeatAck,
    Hello,
    JoinRefusal,
    Notice,
    Report,
    RigConfigMessage,
    TimeReply,
    Trigger,
    UnknownMember,
    Welcome,
)

HEARTBEAT_EVERY_NS = 500_000_000
"""Interval of heartbeats; three unanswered ones are the silence of a lost leader (LEADER_SILENT_NS)."""
HELLO_EVERY_NS, RAREST_HELLO_NS, RARER = 500_000_000, 2_000_000_000, 1.5
"""Interval of hellos, its maximum, and its growth factor: thousands of nodes may have lost the same
leader."""
HELLOS = 3
"""Number of unanswered hellos after which another leader is asked, if there is one."""
NO_ANSWER = "no leader answers: is it running, and does its firewall let UDP through?"
"""Status text of a client whose hellos are not answered."""
STOPPED, FORGOT = "the leader has stopped", "the leader was restarted, or had lost this node"
"""Why a leader no longer knows a client."""

TimeClientEvent = Joined | LeaderNotice | ClockEvent


class TimeClient:
    """Member of one leader at a time; the caller decides the leader's address.

    The caller passes in datagrams and time (`now_ns`, the node's own clock), and takes out datagrams and
    events. No input from the network raises. A bare `TimeClient` is a node without a camera; `Client` adds a
    camera, `TreeMember` further leaders.
    """

    def __init__(
        self,
        name: str,
        instance: int,
        timekeeper: Timekeeper,
        camera: CameraFacts = CLOCK,
        *,
        heartbeat_every_ns: int = HEARTBEAT_EVERY_NS,
        silent_ns: int = LEADER_SILENT_NS,
    ) -> None:
        """A leader that has been silent for `silent_ns` counts as lost."""
        self.name, self.instance, self.camera = name, instance, camera
        self.timekeeper = timekeeper
        self.hellos = 0
        """Number of hellos since this node was last a member; after HELLOS another leader is asked."""
        self.number: int | None = None
        """Number that the leader assigned to this node; None while it is not a member."""
        self.followed: RigConfigMessage | None = None
        """Configuration of the current leader, or of the last one."""
        self.why_joining = ""
        """Reason why it is not a member, if known."""
        self.unanswered = 0
        """Number of hellos since a leader last answered one."""
        self._rng = random.Random(instance)
        self._heartbeat_every_ns, self._silent_ns = heartbeat_every_ns, silent_ns
        self._heartbeat_due_ns, self._heard_ns = NEVER_NS, 0
        self._hello_due_ns = AT_ONCE_NS
        self._outbox: deque[ControlMessage] = deque()
        self._events: deque[Any] = timekeeper.events

    # What the outside sees

    @property
    def is_member(self) -> bool:
        """Whether a leader has admitted this node and is present."""
        return self.number is not None

    @property
    def state(self) -> NodeState:
        """Joining, syncing, or ready: the clock is synchronized to a leader that answers."""
        if self.number is None:
            return NodeState.JOINING
        return NodeState.READY if self.timekeeper.synced else NodeState.SYNCING

    @property
    def time_map(self) -> TimeMap | None:
        """Newest estimate of the root's clock."""
        return self.timekeeper.time_map

    def report(self, now_ns: int) -> Report:
        """Return the report of this node for its leader."""
        return self.timekeeper.report(self.state, self.why_joining, now_ns)

    # In

    def receive_datagram(self, data: bytes, now_ns: int) -> None:
        """Process a datagram that arrived at `now_ns`, stamped as close to the socket as possible."""
        if (message := self.decode(data)) is not None:
            self.receive_message(message, now_ns)

    def decode(self, data: bytes) -> Message | None:
        """Return the message of a datagram; None if it is unreadable."""
        try:
            return decode(data)
        except WireError as error:
            self.note_unreadable(error)
            return None

    def note_unreadable(self, error: WireError) -> None:
        """Note an unreadable datagram: a version mismatch becomes the reason for not being a member."""
        if error.version is not None and not self.is_member:
            self.note_refusal(version_mismatch(error.version))

    def is_addressed(self, message: Message) -> bool:
        """Whether a message is addressed to this member."""
        return self.number is not None and getattr(message, "client", None) == self.number

    def receive_message(self, message: Message, now_ns: int) -> None:
        """Process a message of the leader that arrived at `now_ns`."""
        match message:
            case Welcome() if not self.is_member and message.instance == self.instance:
                if not self.follow(message, now_ns):
                    self.hellos = HELLOS
            case JoinRefusal() if not self.is_member and message.instance == self.instance:
                self.hellos = 0 if message.retry_here else self.hellos
                self.note_refusal(message.reason)
            case TimeReply() if self.is_addressed(message):
                if self.timekeeper.take_reply(message, now_ns):
                    self._heard_ns = now_ns
            case UnknownMember() if self.is_addressed(message):
                self.lose(STOPPED if message.stops else FORGOT, now_ns)
                self.hellos = HELLOS if message.stops else self.hellos
            case HeartbeatAck() | Trigger() | Notice() if self.is_addressed(message):
                self._heard_ns = now_ns
                if isinstance(message, HeartbeatAck):
                    self._take_answer(message, now_ns)
                elif isinstance(message, Notice):
                    self._events.append(LeaderNotice("said", message.text))

    def follow(self, welcome: Welcome, now_ns: int) -> bool:
        """Become a member of the leader that sent this welcome; return False if it cannot be followed."""
        config = welcome.config
        if not config.is_possible or self._objection(config):
            return False
        self.followed, self.number = config, welcome.client
        self.timekeeper.follow(config, welcome.client, welcome.slot, now_ns)
        self.hellos, self.unanswered, self.why_joining = 0, 0, ""
        self._heard_ns = self._heartbeat_due_ns = now_ns
        self._events.append(Joined(welcome.transfer_port, config.leader))
        return True

    def lose(self, reason: str, now_ns: int) -> None:
        """Leave the leader, and ask to join again at once."""
        self.number = None
        self.timekeeper.stop()
        self.why_joining = reason
        self._hello_due_ns = now_ns
        self._events.append(LeaderNotice("lost", reason))

    def leave(self) -> None:
        """Send goodbye, as this node is about to stop."""
        if self.number is not None:
            self._outbox.append(Goodbye(self.number))
        self.number = None
        self.timekeeper.stop()
        self._hello_due_ns = NEVER_NS

    def note_refusal(self, reason: str) -> None:
        """Note why the leader does not admit this node."""
        self.unanswered = 0
        if reason != self.why_joining:
            self.why_joining = reason
            self._events.append(LeaderNotice("refused", reason))

    def report_at_once(self) -> None:
        """Send the next heartbeat at once."""
        self._heartbeat_due_ns = AT_ONCE_NS

    def handle_timer(self, now_ns: int) -> None:
        """Do everything that is due; call it at `next_timer`, or at any other time."""
        if self.number is None:
            if now_ns >= self._hello_due_ns:
                if self.hellos >= HELLOS and not self.why_joining:
                    self.why_joining = NO_ANSWER
                self.hellos += 1
                self.unanswered += 1
                wait_ns = HELLO_EVERY_NS * RARER ** min(max(0, self.unanswered - HELLOS), 10)
                self._hello_due_ns = now_ns + round(
                    self._rng.uniform(0.8, 1.2) * min(wait_ns, RAREST_HELLO_NS)
                )
                self._outbox.append(self.hello())
            return
        if now_ns >= self._heard_ns + self._silent_ns:
            self.lose("the leader is silent", now_ns)
            self.hellos = HELLOS
            return
        was_synced = self.timekeeper.synced
        self.timekeeper.handle_timer(now_ns)
        if now_ns >= self._heartbeat_due_ns or (self.timekeeper.synced and not was_synced):
            self._outbox.append(Heartbeat(self.number, self._report_to_leader(now_ns)))
            self._heartbeat_due_ns = now_ns + self._heartbeat_every_ns

    # Out

    def next_timer(self) -> int:
        """Local time in ns at which `handle_timer` is due."""
        if self.number is None:
            return self._hello_due_ns
        return min(self._heard_ns + self._silent_ns, self.timekeeper.next_timer(), self._heartbeat_due_ns)

    def datagrams_to_send(self, now_ns: int) -> list[bytes]:
        """Return the datagrams for the leader; send at once, as a time request carries `now_ns`."""
        request = self.timekeeper.request_to_send(now_ns)
        datagrams = [] if request is None else [request]
        while self._outbox:
            datagrams.append(encode(self._outbox.popleft()))
        return datagrams

    def next_event(self) -> Any:
        """Return the next event, a `TimeClientEvent`, or None."""
        return self._events.popleft() if self._events else None

    def update_camera(self, camera: CameraFacts) -> None:
        """Update the facts of this node's camera, such as a changed exposure, and send them to the leader."""
        self.camera = camera
        if self.is_member:
            self._outbox.append(self.hello())

    def hello(self) -> Hello:
        """Return the message that asks a leader to admit this node."""
        camera = self.camera
        if camera.kind in WITHOUT_CAMERA and self.followed is not None:
            # After a restart of the root, this lets it lay the grid at the period of the cameras below.
            camera = structs.replace(camera, period_ns=self.followed.period_ns)
        return Hello(self.name, self.instance, camera)

    # The parts

    def _report_to_leader(self, now_ns: int) -> Report:
        return self.report(now_ns)

    def _objection(self, config: RigConfigMessage) -> str:
        """Return why a leader with this configuration cannot be followed; empty if it can.

        A camera's node joins again if the grid's period or the root has changed, as its bursts depend on
        both.
        """
        if self.camera.kind in WITHOUT_CAMERA:
            if self.instance in config.path:
                return "the parent follows this node"
            return "the parent is too far from the root" if len(config.path) > MAX_DEPTH else ""
        if not self.is_member or self.followed is None:
            return ""
        if config.period_ns != self.followed.period_ns:
            return "the leader has another grid of instants"
        return "the relay follows another leader" if config.path[0] != self.followed.path[0] else ""

    def _take_answer(self, answer: HeartbeatAck, now_ns: int) -> None:
        config = answer.config
        reason = self._objection(config) if config.is_possible else "its answers cannot be right"
        if reason:
            self.lose(reason, now_ns)
        elif self.followed is not None and config.leader != self.followed.leader:
            self.lose("the leader has changed", now_ns)
        else:
            self.followed = config
            self.timekeeper.update_config(config)
