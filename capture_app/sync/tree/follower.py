"""A node that only keeps the time: it follows one of several leaders or relays, in rounds, for ever.

A round is a quick succession of time requests, the next one is far off: a leader of many bears it, a radio
sleeps in between, and a few rounds tell the skew, which carries the time over the gaps.
"""

import random
from collections import deque
from dataclasses import dataclass, field

from msgspec import structs

from capture_app.camera_facts import CameraFacts, PhaseControl, TimestampSource
from capture_app.sync.clock.clock_filter import ClockFilter
from capture_app.sync.clock.clock_sample import ClockSample
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.clock.upstream_map import MAX_DEPTH
from capture_app.sync.phase.goal import MAX_PERIOD_NS, MIN_PERIOD_NS, Goal
from capture_app.sync.rig.events import ClockStepped, ClockSynced, Joined, JoinRefused, LeaderLost
from capture_app.sync.rig.failover import WayBack
from capture_app.sync.rig.poll_schedule import LEAST_EXCHANGES, NEVER_NS, Rounds
from capture_app.sync.rig.timekeeper import time_report
from capture_app.sync.wire.messages import (
    CLOCK_ONLY,
    NOBODY,
    Control,
    Goodbye,
    Heartbeat,
    HeartbeatAck,
    Hello,
    Message,
    NodeState,
    Refused,
    TimeReply,
    Unknown,
    Welcome,
    WireError,
    decode,
    encode,
    request_at,
    request_before_t0,
)


@dataclass(slots=True)
class Parent:
    """What the parent told when it took this node in; a leader's path is itself, a relay's begins there."""

    leader: int
    client: int
    slot: float
    pace_ns: int
    path: tuple[int, ...]
    onward: TimeMap | None
    synced: bool = False
    heard_ns: int = 0
    answers: int = 0
    """Time replies since the last round began."""
    outstanding: dict[int, int] = field(default_factory=dict)


def terms_of(message: Welcome | HeartbeatAck) -> tuple[tuple[int, ...], TimeMap | None] | None:
    """Return a parent's path and the map from its clock to the root's; None if nobody can follow it."""
    told = message.onward
    path = (message.leader,) if told is None else (*told.path, message.leader)
    onward = None if told is None else told.time_map()
    if len(path) > MAX_DEPTH or not MIN_PERIOD_NS <= message.period_ns <= MAX_PERIOD_NS:
        return None
    return None if told is not None and onward is None else (path, onward)


Address = tuple[str, int]
FollowerEvent = Joined | JoinRefused | LeaderLost | ClockSynced | ClockStepped

_MS = 1_000_000
_AT_ONCE_NS = -(2**62)
HELLO_EVERY_NS = 500 * _MS
HELLOS = 3
"""Unanswered ones before the next parent is asked."""
MOST_EVENTS = 256
"""Kept for a node that does not look at them."""
SILENT_HEARTBEATS = 4
"""A parent that has said nothing for as long as this many heartbeats is gone."""
WINDOW_NS = 300_000 * _MS
"""Several rounds, for the skew between them; any longer, and a clock is no longer a straight line."""
FURTHEST_NS = 2**62
"""No clock is further from the root's, and no relay could tell its clients so."""
CLOCK = CameraFacts(
    kind=CLOCK_ONLY,
    model="",
    width=0,
    height=0,
    period_ns=33_333_333,
    phase_control=PhaseControl.NONE,
    timestamp_source=TimestampSource.UNKNOWN,
)


@dataclass(frozen=True, slots=True)
class FollowerConfig:
    """What a follower is; `parents` are asked in turn, the best one first."""

    name: str
    instance: int
    parents: tuple[Address, ...]
    camera: CameraFacts = CLOCK
    """What it tells of itself; a relay of cameras is of another kind."""
    heartbeat_every_ns: int | None = None
    """Without it, it speaks once a round, and notices but then that its parent is silent."""


class Follower:
    """The time of a tree's root; `now_ns` is always the node's own clock.

    When its parent falls silent it asks the next one, and holds the time over with what it knows.
    """

    def __init__(self, config: FollowerConfig, rng: random.Random) -> None:
        self.config = config
        self.clock = ClockFilter(window_ns=WINDOW_NS)
        self.malformed = 0
        self.goal: Goal | None = None
        self.agreed_leader_ns: int | None = None
        self.align_row: float | None = None
        self.parent_is_alone = False
        self.path: tuple[int, ...] = ()
        """Instances from the root to the parent of the newest estimate."""
        self.time_map: TimeMap | None = None
        """From this node's clock to the root's; it outlives its parent, with error bars that grow."""
        self._root: int | None = None
        self._turn = 0
        self._hellos = 0
        self._parent: Parent | None = None
        self._clock_of: int | None = None
        self._map_of: int | None = None
        """Whose clock `clock` is about, and by whose answers `time_map` was found."""
        self._why_joining = ""
        self._sequence = rng.getrandbits(32)
        self._hello_due_ns = _AT_ONCE_NS
        self._heartbeat_due_ns = NEVER_NS
        self._rounds = Rounds()
        self._way_back = WayBack(config.parents)
        self._better: Address | None = None
        """A better parent that was asked whether it takes this node in, while the present one is followed."""
        self._request: bytes | None = None
        self._outbox: deque[tuple[Control, Address]] = deque()
        self._events: deque[FollowerEvent] = deque(maxlen=MOST_EVENTS)

    @property
    def parent(self) -> Address:
        """The address of the one that is followed, or asked at present."""
        return self.config.parents[self._turn]

    @property
    def root(self) -> int | None:
        """The run of the root that `goal` is of; that of `time_map` is the first of `path`."""
        return self._root

    @property
    def number(self) -> int | None:
        """What the parent knows this node by; None where it has none at present."""
        return None if self._parent is None else self._parent.client

    @property
    def state(self) -> NodeState:
        """Joining, syncing, or ready: the time is that of a parent who is there."""
        if self._parent is None:
            return NodeState.JOINING
        return NodeState.READY if self._parent.synced else NodeState.SYNCING

    # In

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        """Take in a datagram that arrived at `now_ns`."""
        if address not in self.config.parents:
            return
        try:
            message = decode(data)
        except WireError:
            self.malformed += 1
            return
        if address == self.parent:
            self.take(message, now_ns)
        else:
            self.hear_of(message, address, now_ns)

    def hear_of(self, message: Message, address: Address, now_ns: int) -> None:
        """Take in a message of another parent than the present one: it may be a better one that is back."""
        match message:
            case Unknown() if message.client == NOBODY:
                self._way_back.answered(address)
            case Welcome() if address == self._better and message.instance == self.config.instance:
                self._go_back(address, message, now_ns)
            case _:
                pass

    def take(self, message: Message, now_ns: int) -> None:
        """Take in a message of the present parent that arrived at `now_ns`."""
        parent = self._parent
        match message:
            case TimeReply() if parent is not None and message.client == parent.client:
                self._take_time(parent, message, now_ns)
            case Welcome() if parent is None and message.instance == self.config.instance:
                self._join(message, now_ns)
            case Refused() if parent is None and message.instance == self.config.instance:
                self._hellos = 0 if message.soon else self._hellos
                if message.reason != self._why_joining:
                    self._why_joining = message.reason
                    self._events.append(JoinRefused(message.reason))
            case HeartbeatAck() if parent is not None and message.client == parent.client:
                if message.leader != parent.leader or not self._take_terms(parent, message):
                    self._leave("the parent has changed", now_ns)
                else:
                    parent.pace_ns, parent.heard_ns = message.pace_ns, now_ns
            case Unknown() if parent is not None and message.client == parent.client:
                self._leave("the parent was restarted", now_ns)
            case _:
                pass

    def handle_timer(self, now_ns: int) -> None:
        """Do what is due; call it at `next_timer`, or any time."""
        parent = self._parent
        if parent is None:
            if now_ns >= self._hello_due_ns:
                self._hello(now_ns)
            return
        every_ns = self.config.heartbeat_every_ns
        if every_ns is not None and now_ns - parent.heard_ns >= SILENT_HEARTBEATS * every_ns:
            self._give_up(now_ns)
            return
        if every_ns is not None and now_ns >= self._heartbeat_due_ns:
            self._heartbeat_due_ns = now_ns + every_ns
            self._report(parent, now_ns)
        if now_ns >= self._rounds.settle_due_ns:
            self._settle(parent, now_ns)
        if now_ns >= self._rounds.request_due_ns:
            self._ask(parent, now_ns)
        if now_ns >= self._way_back.due_ns and self._parent is not None:
            self._better = self._way_back.look(self.parent, now_ns, alone=self.parent_is_alone)
            if self._better is not None:
                self._outbox.append((self._own_hello(), self._better))

    # Out

    def next_timer(self) -> int:
        """Local time in ns at which `handle_timer` wants to be called."""
        if self._parent is None:
            return self._hello_due_ns
        rounds = self._rounds
        return min(rounds.request_due_ns, rounds.settle_due_ns, self._heartbeat_due_ns, self._way_back.due_ns)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return datagrams and where to; a time request carries `now_ns`, so send them at once."""
        datagrams = []
        if self._request is not None and self._parent is not None:
            datagrams.append((request_at(self._request, now_ns), self.parent))
            self._parent.outstanding[self._sequence] = now_ns
        self._request = None
        while self._outbox:
            message, address = self._outbox.popleft()
            datagrams.append((encode(message), address))
        return datagrams + self._way_back.datagrams_to_send()

    def leave(self) -> None:
        """Say goodbye: this node is about to stop."""
        if self._parent is not None:
            self._outbox.append((Goodbye(self._parent.client), self.parent))
        self._parent = None
        self._hello_due_ns = NEVER_NS

    def next_event(self) -> FollowerEvent | None:
        """Return the next thing that happened, None where there is none."""
        return self._events.popleft() if self._events else None

    # The parts

    def _hello(self, now_ns: int) -> None:
        if self._hellos >= HELLOS:
            self._turn = (self._turn + 1) % len(self.config.parents)
            self._hellos = 0
        self._hellos += 1
        self._hello_due_ns = now_ns + HELLO_EVERY_NS
        self._outbox.append((self._own_hello(), self.parent))

    def _own_hello(self) -> Hello:
        camera = self.config.camera
        if self.goal is not None:
            # A root that has been started anew can lay its grid as the cameras below have it.
            camera = structs.replace(camera, period_ns=self.goal.period_ns)
        return Hello(self.config.name, self.config.instance, camera)

    def _join(self, welcome: Welcome, now_ns: int, *, back: bool = False) -> None:
        parent = Parent(welcome.leader, welcome.client, welcome.slot, welcome.pace_ns, (), None)
        if not self._take_terms(parent, welcome):
            # Who follows this node itself, or is too far down, is asked no more; the next one is.
            self._hellos = HELLOS
            return
        if welcome.leader != self._clock_of:
            self.clock.reset()
            self._clock_of = welcome.leader
        if parent.path[:1] != self.path[:1]:
            # Another root has another time.
            self.time_map = None
        self._parent = parent
        self._why_joining = ""
        self._hellos = 0
        self._rounds.begin(now_ns)
        self._way_back.follow(now_ns, back=back)
        parent.heard_ns = now_ns
        self._heartbeat_due_ns = NEVER_NS if self.config.heartbeat_every_ns is None else now_ns
        self._events.append(Joined(welcome.transfer_port, welcome.leader))

    def _go_back(self, address: Address, welcome: Welcome, now_ns: int) -> None:
        """Follow a better parent that is back, if its terms are good; the time of before is held over."""
        terms = terms_of(welcome)
        self._better = None
        if self._parent is None or terms is None or self.config.instance in terms[0]:
            return
        self._outbox.append((Goodbye(self._parent.client), self.parent))
        self._turn = self.config.parents.index(address)
        self._request = None
        self._join(welcome, now_ns, back=True)

    def _take_terms(self, parent: Parent, message: Welcome | HeartbeatAck) -> bool:
        """Note where the parent's clock stands in the tree; False if this node must not follow it."""
        terms = terms_of(message)
        if terms is None or self.config.instance in terms[0]:
            return False
        parent.path, parent.onward = terms
        self._root = parent.path[0]
        self.goal = Goal(message.anchor_leader_ns, message.period_ns)
        self.align_row = message.align_row
        self.parent_is_alone = isinstance(message, HeartbeatAck) and message.alone
        self.agreed_leader_ns = message.agreed_leader_ns if isinstance(message, HeartbeatAck) else None
        return True

    def _leave(self, reason: str, now_ns: int) -> None:
        self._way_back.lose(self.parent, now_ns)
        self._parent = self._better = None
        self._request = None
        self._why_joining = reason
        self._hello_due_ns = now_ns
        self._events.append(LeaderLost(reason))

    def _give_up(self, now_ns: int) -> None:
        self._hellos = HELLOS
        self._leave("the parent is silent", now_ns)

    def _take_time(self, parent: Parent, reply: TimeReply, now_ns: int) -> None:
        t0_ns = parent.outstanding.pop(reply.sequence, None)
        if t0_ns is None or t0_ns != reply.t0_ns:
            return
        parent.answers += 1
        parent.heard_ns = now_ns
        if not self.clock.add(ClockSample(t0_ns, reply.t1_ns, reply.t2_ns, now_ns)):
            parent.synced = False
            self.time_map = None
            self._rounds.restart(now_ns)
            self._events.append(ClockStepped())

    def _ask(self, parent: Parent, now_ns: int) -> None:
        """Prepare the next request of a round, and with the last one a report."""
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        self._request = request_before_t0(parent.client, self._sequence)
        last = self._rounds.asked(now_ns, parent.pace_ns, parent.slot, self.time_map)
        if last and self.config.heartbeat_every_ns is None:
            self._report(parent, now_ns)

    def _report(self, parent: Parent, now_ns: int) -> None:
        report = time_report(self.state, self._why_joining, self.time_map, self.clock.samples, now_ns)
        self._outbox.append((Heartbeat(parent.client, report), self.parent))

    def _settle(self, parent: Parent, now_ns: int) -> None:
        """Estimate the time anew at the end of a round, or look for another parent if none answered."""
        self._rounds.settle_due_ns = NEVER_NS
        if parent.answers == 0:
            self._give_up(now_ns)
            return
        parent.answers = 0
        parent.outstanding.clear()
        time_map = self.clock.time_map(now_ns)
        if time_map is None or self.clock.samples < LEAST_EXCHANGES:
            return
        time_map = time_map if parent.onward is None else time_map.chained_to(parent.onward)
        if abs(time_map.offset_ns) > FURTHEST_NS or self._is_worse(time_map, parent):
            return
        self.time_map, self._map_of, self.path = time_map, parent.leader, parent.path
        if not parent.synced:
            parent.synced = True
            self._events.append(ClockSynced(time_map))

    def _is_worse(self, time_map: TimeMap, parent: Parent) -> bool:
        """Whether what was learned from the parent before is better still: it knows the skew."""
        held = self.time_map
        if held is None or self._map_of == parent.leader:
            return False
        until_ns = self._rounds.request_due_ns
        return held.uncertainty_at(until_ns) < time_map.uncertainty_at(until_ns)
