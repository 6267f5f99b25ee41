"""What a member owes its leaders, in histories that are drawn.

It follows one that answers it, asks the others in turn once that is silent, and returns to a preferred one
that has answered for long; who is not followed is not believed.
"""

import random
from dataclasses import dataclass, field

from hypothesis import given, settings

from capture_app.common.timeouts import LEADER_SILENT_NS
from capture_app.sync.rig.events import Joined, LeaderNotice
from capture_app.sync.rig.failover import MAX_ANSWERS, MIN_ANSWERS, PROBE_EVERY_NS, SHORT_STAY
from capture_app.sync.rig.time_client import FORGOT, HELLOS, NO_ANSWER, STOPPED
from capture_app.sync.sync_engine import Address
from capture_app.sync.timekeeping.poll_schedule import NEVER_NS
from capture_app.sync.tree.member import HEARTBEAT_EVERY_NS, TreeMember
from capture_app.sync.wire.codec import Message, decode, encode
from capture_app.sync.wire.datagrams import (
    PROBE_NUMBER,
    Goodbye,
    Heartbeat,
    HeartbeatAck,
    Hello,
    JoinRefusal,
    Notice,
    RigConfigMessage,
    TimeReply,
    TimeRequest,
    UnknownMember,
    Welcome,
)
from tests.histories import histories
from tests.unit.sync.tree.seldom import S, Seldom

INSTANCE, TRIP_NS = 77, 200_000
WAITS_NS = (S // 10, S, 3 * S, 8 * S, PROBE_EVERY_NS, 5 * PROBE_EVERY_NS)
REFUSED = "another camera named me is here"


@dataclass
class Leader:
    """A leader that answers at once, or not at all."""

    instance: int
    is_alive: bool = True
    refuses: bool = False
    in_holdover: bool = False
    number: int | None = None
    """Number of the member here; None if it is not known."""
    needed: int = MIN_ANSWERS
    answers: int = 0
    """Probes that were answered one after the other."""
    was_up: bool = False
    """Whether the last probe was answered."""

    @property
    def config(self) -> RigConfigMessage:
        return RigConfigMessage(
            leader=self.instance, anchor_leader_ns=0, period_ns=33_333_333, in_holdover=self.in_holdover
        )


@dataclass
class Duty:
    """A member and its leaders, the best first; each method is something that happens."""

    leaders: dict[Address, Leader] = field(
        default_factory=lambda: {(name, 1): Leader(10 + n) for n, name in enumerate("abc")}
    )
    now_ns: int = 100 * S
    numbers: int = 100
    """Last number that a leader has given out."""
    asked: Address = ("a", 1)
    hellos: int = 0
    """Hellos to the leader that is asked."""
    followed: Address | None = None
    heard_ns: int = 0
    probe_ns: int = NEVER_NS
    back_ns: int | None = None
    """When it returned to the followed leader, as probes had answered; None if it asked each in turn."""
    better: Address | None = None
    beat_ns: int = 0
    hello_ns: int | None = None
    """Time of the last hello; None if it has just been lost, and the next one is due at once."""
    unanswered: int = 0
    in_vain: int = 0
    """Number of unanswered hellos when the last one was sent, which decides when the next one is."""
    why: str = ""
    config: RigConfigMessage | None = None
    owed: set[Address] = field(default_factory=set)
    """Former leaders that it has not said goodbye to."""
    events: list[object] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.member = TreeMember("me", INSTANCE, tuple(self.leaders), random.Random(1))
        self.member.time.timekeeper.schedule = Seldom()

    # What the leaders do

    def _at(self, number: int) -> tuple[Address, Leader]:
        return [*self.leaders.items()][number % 3]

    def _say(self, message: Message, address: Address) -> None:
        self.member.receive_datagram(encode(message), address, self.now_ns)

    def kill(self, number: int) -> None:
        self._at(number)[1].is_alive = False

    def go_out(self, number: int) -> None:
        """A leader is gone for some seconds."""
        self.kill(number)
        self.wait(2)
        self.revive(number)
        self.wait(number // 3 % 6)

    def revive(self, number: int) -> None:
        self._at(number)[1].is_alive = True

    def restart(self, number: int) -> None:
        """A leader forgets its members: the next heartbeat is answered so."""
        leader = self._at(number)[1]
        leader.number, leader.is_alive = None, True

    def refuse(self, number: int) -> None:
        leader = self._at(number)[1]
        leader.refuses = not leader.refuses

    def lose_root(self, number: int) -> None:
        """A leader is a relay in holdover, or no longer."""
        leader = self._at(number)[1]
        leader.in_holdover = not leader.in_holdover

    def stop(self, number: int) -> None:
        """A leader ends in order, and says so to its member."""
        address, leader = self._at(number)
        if leader.is_alive and leader.number is not None:
            self._say(UnknownMember(leader.number, stops=True), address)
            leader.number, leader.is_alive = None, False
            if self.followed == address:
                self._lose(STOPPED, hellos=HELLOS)

    def notify(self, number: int) -> None:
        address, leader = self._at(number)
        if leader.is_alive and leader.number is not None:
            self._say(Notice(leader.number, "two cameras are a"), address)
            if self.followed == address:
                self.heard_ns = self.now_ns
                self.events.append(LeaderNotice("said", "two cameras are a"))

    def mislead(self, number: int) -> None:
        """Somebody who is not followed says all that the leader could, and the leader what is for others."""
        time = self.member.time
        own = time.number or 0
        (address, leader), other = self._at(number), own + 1
        self._say(Welcome(INSTANCE + 1, 9, 1, leader.config), address)
        self._say(JoinRefusal(INSTANCE + 1, "no"), address)
        for_others = UnknownMember(other), HeartbeatAck(other, leader.config), Notice(other, "not for it")
        for_it = (
            UnknownMember(own),
            HeartbeatAck(own, leader.config),
            Notice(own, "hm"),
            TimeReply(own, 1, 0, 0, 0),
        )
        for message in for_others if address == self.followed else for_it:
            self._say(message, address)
        if self.followed is not None and address != self.better:
            self._say(Welcome(INSTANCE, 9, 1, leader.config), address)
            self._say(JoinRefusal(INSTANCE, "no"), address)
        self._say(Welcome(INSTANCE, 9, 1, leader.config), ("stranger", 1))

    # What the member does

    def wait(self, number: int) -> None:
        until_ns = self.now_ns + WAITS_NS[number % len(WAITS_NS)]
        self._run(until_ns)

    def _run(self, until_ns: int) -> None:
        while (due_ns := self.member.next_timer()) <= until_ns:
            self.now_ns = max(self.now_ns, due_ns)
            self._handle_timer()
        self.now_ns = max(self.now_ns, until_ns)

    def _handle_timer(self) -> None:
        is_silent = self.followed is not None and self.now_ns >= self.heard_ns + LEADER_SILENT_NS
        if is_silent:
            self._lose("the leader is silent", hellos=HELLOS)
        self.member.handle_timer(self.now_ns)
        probed = self._due_probes()
        for data, address in self.member.datagrams_to_send(self.now_ns):
            message = decode(data)
            if isinstance(message, Hello):
                self._hear_hello(message, address)
            elif isinstance(message, Heartbeat) and message.client == PROBE_NUMBER:
                probed.remove(address)
                if self.leaders[address].is_alive:
                    self._say(UnknownMember(PROBE_NUMBER), address)
            elif isinstance(message, Goodbye):
                self.leaders[address].number = None
                self.owed.remove(address)
            elif self.followed is not None or not isinstance(message, TimeRequest):
                assert address == self.followed, "it is for the leader alone"
                self._hear(message, self.leaders[address])
        assert not probed, "they are not asked whether they are back"

    def _due_probes(self) -> list[Address]:
        """Note that it is time to probe preferred leaders, or all others if the followed is in holdover."""
        if self.followed is None or self.now_ns < self.probe_ns:
            return []
        self.probe_ns = self.now_ns + PROBE_EVERY_NS
        names = [*self.leaders]
        assert self.config is not None
        better = names[: names.index(self.followed)]
        if self.config.in_holdover:
            better = [name for name in names if name != self.followed]
        for name, leader in self.leaders.items():
            if name not in better:
                leader.answers, leader.was_up = 0, False
                continue
            leader.answers = leader.answers + 1 if leader.was_up else 0
            leader.was_up = leader.is_alive
        needed = {name: 1 if self.config.in_holdover else self.leaders[name].needed for name in better}
        self.better = next(
            (name for name in better if self.leaders[name].answers >= needed[name]), self.better
        )
        return better

    def _hear_hello(self, hello: Hello, address: Address) -> None:
        assert (hello.name, hello.instance) == ("me", INSTANCE)
        leader = self.leaders[address]
        if self.followed is None:
            self._note_pace()
            if self.hellos >= HELLOS:
                self.why = self.why or NO_ANSWER
            self.hellos += 1
            if self.hellos > HELLOS:
                names = [*self.leaders]
                self.asked, self.hellos = names[(names.index(self.asked) + 1) % 3], 1
                self.back_ns = None
            assert address == self.asked, "the leaders are asked in turn, each some times"
        else:
            assert address == self.better, "it need not join there"
        if not leader.is_alive:
            return
        if leader.refuses:
            if self.followed is None:
                if self.why != REFUSED:
                    self.events.append(LeaderNotice("refused", REFUSED))
                self.why, self.unanswered = REFUSED, 0
            self._say(JoinRefusal(INSTANCE, REFUSED), address)
            return
        self.numbers += 1
        former, leader.number = self.followed, self.numbers
        self._say(Welcome(INSTANCE, self.numbers, 5, leader.config), address)
        self.events.append(Joined(5, leader.instance))
        self.back_ns = self.now_ns if former is not None else None
        self.followed = self.asked = address
        self.heard_ns, self.hellos, self.better, self.why = self.now_ns, 0, None, ""
        self.probe_ns, self.unanswered, self.config = self.now_ns, 0, leader.config
        if former is not None:
            self.owed.add(former)
        self._forget_answers()

    def _note_pace(self) -> None:
        """Check that it asks at once, then twice a second, and ever more seldom where nobody answers."""
        gap_ns = 0 if self.hello_ns is None else self.now_ns - self.hello_ns
        assert self.hello_ns is None or 0.4 * S <= gap_ns <= 2.4 * S
        assert self.in_vain > HELLOS or gap_ns <= 0.6 * S
        assert self.in_vain < HELLOS + 5 or gap_ns >= 1.6 * S
        self.unanswered += 1
        self.hello_ns, self.in_vain = self.now_ns, self.unanswered

    def _forget_answers(self) -> None:
        for leader in self.leaders.values():
            leader.answers, leader.was_up = 0, False

    def _hear(self, message: Message, leader: Leader) -> None:
        assert self.followed is not None
        if not leader.is_alive:
            self.beat_ns = self.now_ns if isinstance(message, Heartbeat) else self.beat_ns
            return
        if isinstance(message, TimeRequest):
            if message.client == leader.number:
                self.now_ns += TRIP_NS
                at_ns = message.t0_ns + TRIP_NS // 2
                self._say(
                    TimeReply(message.client, message.sequence, message.t0_ns, at_ns, at_ns), self.followed
                )
                self.heard_ns = self.now_ns
        elif isinstance(message, Heartbeat):
            self.beat_ns = self.now_ns
            if message.client == leader.number:
                self._say(HeartbeatAck(message.client, leader.config), self.followed)
                self.heard_ns, self.config = self.now_ns, leader.config
            else:
                self._say(UnknownMember(message.client), self.followed)
                self._lose(FORGOT, hellos=0)

    def _lose(self, reason: str, *, hellos: int) -> None:
        assert self.followed is not None
        leader = self.leaders[self.followed]
        if self.back_ns is not None:
            is_soon = self.now_ns - self.back_ns < SHORT_STAY * leader.needed * PROBE_EVERY_NS
            leader.needed = min(2 * leader.needed, MAX_ANSWERS) if is_soon else MIN_ANSWERS
        self.events.append(LeaderNotice("lost", reason))
        self.followed, self.hellos, self.why = None, hellos, reason
        self.hello_ns, self.unanswered, self.in_vain = None, 0, 0
        self._forget_answers()

    def check(self) -> None:
        self._run(self.now_ns)
        time = self.member.time
        assert time.is_member == (self.followed is not None)
        assert self.member.leader == (self.followed or self.asked)
        assert (time.why_joining, time.unanswered, time.followed) == (self.why, self.unanswered, self.config)
        events = [event for event in iter(time.next_event, None) if isinstance(event, Joined | LeaderNotice)]
        assert events == self.events
        self.events = []
        assert not self.owed, "they would wait for it"
        if self.followed is None:
            assert self.hello_ns is not None, "it asks nobody"
            return
        assert self.now_ns < self.heard_ns + LEADER_SILENT_NS
        assert self.now_ns < self.beat_ns + HEARTBEAT_EVERY_NS, "its leader would miss it"

    def leave(self) -> None:
        """End in order."""
        number = self.member.time.number
        self.member.leave()
        goodbye = [] if self.followed is None or number is None else [(Goodbye(number), self.followed)]
        sent = [(decode(data), address) for data, address in self.member.datagrams_to_send(self.now_ns)]
        assert sent == goodbye
        assert not self.member.time.is_member
        self.member.handle_timer(self.now_ns + 60 * S)
        assert self.member.datagrams_to_send(self.now_ns) == []


USUAL = ("wait", "go_out", "go_out", "kill", "revive", "lose_root")
OTHERS = ("restart", "refuse", "stop", "notify", "mislead")


@settings(max_examples=40)
@given(histories(USUAL, OTHERS, max_steps=40, max_others=3, numbers=18))
def test_it_follows_who_answers_and_believes_nobody_else(history: list[tuple[str, int]]) -> None:
    duty = Duty()
    for step, number in history:
        getattr(duty, step)(number)
        duty.check()
    duty.leave()
