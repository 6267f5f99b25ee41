"""What a leader owes its members, in histories that are drawn.

Who has joined, is lost or returns, and by whose messages; each is answered at the address that it uses now,
and each change is reported once.
"""

import random
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_app.common.camera_facts import CameraFacts
from capture_app.common.errors import BadInputError
from capture_app.common.node_state import CLOCK_ONLY, RELAY, NodeState
from capture_app.common.timeouts import (
    CLIENT_SILENT_NS,
    CLIENT_UNREPORTED_NS,
    FORGET_LOST_NS,
    UNREPORTED_PER_CLIENT_NS,
)
from capture_app.sync.rig.events import LeaderEvent, NodeChanged
from capture_app.sync.rig.leader_engine import MIN_REPORT_INTERVAL_NS, REPEAT_REPORT_NS, Leader, LeaderConfig
from capture_app.sync.rig.roster import LEFT
from capture_app.sync.sync_engine import Address
from capture_app.sync.timekeeping.poll_schedule import NEVER_NS
from capture_app.sync.wire.codec import FromClient, decode, encode
from capture_app.sync.wire.datagrams import (
    PROBE_NUMBER,
    Goodbye,
    Heartbeat,
    HeartbeatAck,
    Hello,
    JoinRefusal,
    MemberReports,
    Notice,
    Principal,
    Report,
    TimeReply,
    TimeRequest,
    UnknownMember,
    Welcome,
)
from tests.facts import make_facts
from tests.histories import histories

S, PORT = 10**9, 4711
KINDS = {"a": "sim", "b": "sim", "clock": CLOCK_ONLY, "gate": RELAY}
PINS = {"a": "this", "b": "this", "clock": "that", "gate": "hall", "thief": "that"}
CAMERAS = ("a", "b", "clock")
WAITS_NS = (S // 4 + 7, S, 2 * S - 1, 3 * S, 8 * S, FORGET_LOST_NS)


@dataclass
class Known:
    """A member as the messages until now say."""

    instance: int
    number: int
    slot: float
    address: Address
    via: str | None
    principal: Principal | None
    """Whose messages are believed to be the member's."""
    heard_ns: int
    is_confirmed: bool
    has_taken: bool
    frames: int = 0
    state: NodeState = NodeState.JOINING
    lost: str = ""
    exposure_ns: int = 0
    """Exposure of its last hello: it may change while it is here."""


class Duty:
    """A leader and its clients; each method is something that happens."""

    def __init__(self, *, is_open: bool) -> None:
        self.is_open = is_open
        self.leader = Leader(LeaderConfig(7, PORT), random.Random(1))
        self.now_ns = 100 * S
        self.known: dict[str, Known] = {}
        self.owners: dict[str, str] = {}
        self.instances = dict.fromkeys(KINDS, 1)
        self.ports = dict.fromkeys(KINDS, 1)
        self.former: list[int] = []
        """Numbers that members had before they joined again or were removed."""
        self.reported: dict[str, tuple[str, int]] = {}
        self.events: list[LeaderEvent] = []
        self.sent: list[tuple[object, Address]] = []
        self.impostures = 0

    # What the clients send

    def _principal(self, name: str, via: str | None = None) -> Principal | None:
        name = via or name
        return (
            None
            if self.is_open
            else Principal(name, self.instances[name], PINS[name], is_relay=KINDS[name] == RELAY)
        )

    def _hear(self, message: FromClient, address: Address, principal: Principal | None) -> None:
        self.leader.receive_datagram(encode(message), address, self.now_ns, principal)

    def _facts(self, name: str) -> CameraFacts:
        return make_facts(kind=KINDS[name], exposure_ns=self.now_ns % 1000)

    def _is_here(self, name: str) -> bool:
        return name in self.known and not self.known[name].lost

    def _address(self, name: str, via: str | None) -> Address:
        return (via or name, self.ports[via or name])

    def _refuse(self, name: str, pin: str, reason: str, address: Address, where: str, instance: int) -> None:
        self.sent.append((JoinRefusal(instance, reason), address))
        before, since_ns = self.reported.get(pin, ("", self.now_ns - REPEAT_REPORT_NS))
        if self.now_ns - since_ns >= (REPEAT_REPORT_NS if before == reason else MIN_REPORT_INTERVAL_NS):
            self.reported[pin] = reason, self.now_ns
            self.events.append(NodeChanged(name, "refused", reason, where))
            if self._is_here(name) and self.known[name].instance != instance:
                text = f"another camera {where} wants to be {name}, too: give one another --name"
                owner = self.known[name]
                self.sent.append((Notice(owner.number, text), owner.address))

    def hello(self, number: int) -> None:
        """A client joins, again, or at another place: below the relay, or directly."""
        name = ("gate", *CAMERAS)[number % 4]
        via = "gate" if number >= 4 and name != "gate" and self._is_here("gate") else None
        address, instance, known = self._address(name, via), self.instances[name], self.known.get(name)
        # A relay has seen the pin; a client may claim any.
        hello = Hello(name, instance, self._facts(name), via, PINS[name] if via else "claimed")
        self._hear(hello, address, self._principal(name, via))
        where = f"below {via}" if via else f"at {name}"
        if known is not None and not known.lost and known.instance != instance:
            refusal = f"another camera named {name} is here: give this one another --name"
            self._refuse(name, address[0] if self.is_open else PINS[name], refusal, address, where, instance)
        else:
            self._admit(name, via, address)

    def _admit(self, name: str, via: str | None, address: Address) -> None:
        instance, known, principal = self.instances[name], self.known.get(name), self._principal(name, via)
        member = self.leader.roster.members[name]
        if not self.is_open:
            self.owners[name] = PINS[name]
        if known is not None and not known.lost and known.via == via:
            known.heard_ns, known.principal = self.now_ns, principal
        else:
            if known is not None:
                self.former.append(known.number)
            assert member.number not in (PROBE_NUMBER, *self.former), "a late message would be believed"
            assert member.slot not in [of.slot for other, of in self.known.items() if other != name]
            self.known[name] = Known(
                instance,
                member.number,
                member.slot,
                address,
                via,
                principal,
                self.now_ns,
                known is not None and known.instance == instance and known.is_confirmed,
                known is not None and known.has_taken,
            )
            change = "joined" if known is None else "returned" if known.lost else "moved"
            self.events.append(
                NodeChanged(name, change, where=(via or "") if change == "moved" else "")  # type: ignore[arg-type]
            )
        of = self.known[name]
        of.exposure_ns = self.now_ns % 1000
        config = self.leader.current.message(0)
        self.sent.append((Welcome(instance, of.number, PORT, config, of.slot), address))

    def restart(self, number: int) -> None:
        """A client's process was killed and started: another run of the same name, which soon says hello."""
        self.instances[("gate", *CAMERAS)[number % 4]] += 1
        self.wait(number % 2 * 3)
        self.hello(number)
        self.hello(5)

    def rebind(self, number: int) -> None:
        """A client's messages come from another port, as behind a router."""
        self.ports[("gate", *CAMERAS)[number % 4]] += 1

    def steal(self, number: int) -> None:
        """Another machine asks for a name: in its own name, or in that of a node which it is not."""
        name, address = CAMERAS[number % 2], ("thief", 1)
        if self.is_open:
            return
        self._hear(Hello(name, 99, self._facts(name)), address, Principal("other", 99, PINS["thief"]))
        below = Hello(name, 99, self._facts(name), "gate", PINS[name])
        self._hear(below, address, Principal(name, 99, PINS["thief"]))
        self.impostures += 2
        if name in self.owners:
            hello = Hello(name, 99, self._facts(name), pin=PINS["thief"])
            refusal = self.leader.roster.refusal(hello)
            assert "two machines" in refusal
            self._hear(hello, address, Principal(name, 99, PINS["thief"]))
            self._refuse(name, PINS["thief"], refusal, address, "at thief", 99)

    def forge(self, number: int) -> None:
        """A member uses another one's number."""
        name, other = (("a", "clock"), ("clock", "b"), ("gate", "a"))[number % 3]
        if name in self.known and not self.is_open:
            at = self.known[name].number
            lost = Report(state=NodeState.LOST)
            for message in (TimeRequest(at, 1, 2), Heartbeat(at, lost), Goodbye(at)):
                self._hear(message, (other, 9), self._principal(other))
            if self._is_here(name):
                self.impostures += 3
            else:
                self.sent.append((UnknownMember(at), (other, 9)))

    def _member(self, number: int) -> tuple[str, Known | None]:
        """Return a client that knows its number: neither it nor its relay was started again since."""
        name = ("gate", *CAMERAS)[number % 4]
        of = self.known.get(name)
        knows = of is not None and (of.instance, of.principal) == (
            self.instances[name],
            self._principal(name, of.via),
        )
        return name, of if knows else None

    def beat(self, number: int) -> None:
        name, of = self._member(number)
        if of is None:
            return
        address = self._address(name, of.via)
        report = Report(state=NodeState.READY if number < 4 else NodeState.SYNCING, frames=of.frames + number)
        beat = Heartbeat(of.number, report)
        message = beat if of.via is None else MemberReports(((of.number, report),))
        self._hear(message, address, self._principal(name, of.via))
        if of.lost:
            self.sent.append((UnknownMember(of.number), address))
            return
        self._used(of, address)
        of.state, of.frames, of.has_taken = report.state, report.frames, of.has_taken or report.frames > 0
        if of.via is None:
            self.sent.append((HeartbeatAck(of.number, self.leader.current.message(0)), address))

    def _used(self, of: Known, address: Address) -> None:
        of.address, of.heard_ns, of.is_confirmed = address, self.now_ns, True

    def ask(self, number: int) -> None:
        """A time request is answered before all else, with the times of its arrival and of the answer."""
        name, of = self._member(number)
        if of is None or of.lost:
            return
        address = self._address(name, of.via)
        self._hear(TimeRequest(of.number, 5, 6), address, self._principal(name, of.via))
        self._used(of, address)
        reply = TimeReply(of.number, 5, 6, self.now_ns, self.now_ns + 9)
        assert self._take_sent(self.now_ns + 9)[0] == (reply, address)

    def sign_off(self, number: int) -> None:
        name, of = self._member(number)
        if of is not None and not of.lost:
            self._hear(Goodbye(of.number), self._address(name, of.via), self._principal(name, of.via))
            self._used(of, self._address(name, of.via))
            self._lose(name, LEFT)

    def report_loss(self, number: int) -> None:
        """The relay reports that a camera below it is lost."""
        below = [of for of in map(self._member, range(4)) if of[1] and of[1].via and not of[1].lost]
        if not below:
            return
        name, of = below[number % len(below)]
        assert of is not None
        message = "silent for 2 s" if number < 3 else ""
        reports = MemberReports(((of.number, Report(state=NodeState.LOST, message=message)),))
        address = self._address(name, of.via)
        self._hear(reports, address, self._principal(name, of.via))
        of.address, of.heard_ns = address, self.now_ns
        self._lose(name, message or LEFT)

    def _lose(self, name: str, reason: str) -> None:
        of = self.known[name]
        of.lost, of.state = reason, NodeState.LOST
        if of.is_confirmed or of.has_taken:
            self.events.append(NodeChanged(name, "lost", reason))
        else:
            self._forget(name)

    def _forget(self, name: str) -> None:
        self.former.append(self.known.pop(name).number)
        self.events.append(NodeChanged(name, "forgotten"))

    def speak_late(self, number: int) -> None:
        """A client uses the number that it had before."""
        if self.former:
            at = self.former[number % len(self.former)]
            for message in (TimeRequest(at, 1, 2), Goodbye(at), Heartbeat(at, Report(state=NodeState.READY))):
                self._hear(message, ("late", 1), self._principal("a"))
            self.sent.append((UnknownMember(at), ("late", 1)))

    # What its operator does

    def remove(self, number: int) -> None:
        """An operator releases a name: of a lost member, or of a machine that is long gone."""
        name = CAMERAS[number % 3]
        if self._is_here(name) or name not in {*self.owners, *self.known}:
            with pytest.raises(BadInputError):
                self.leader.forget(name)
            return
        self.leader.forget(name)
        self.owners.pop(name, None)
        if name in self.known:
            self._forget(name)
        else:
            self.events.append(NodeChanged(name, "forgotten"))

    def stop(self, number: int) -> None:
        self.leader.leave()
        for name, of in self.known.items():
            if self._is_here(name) and of.via is None:
                self.sent.append((UnknownMember(of.number, stops=True), of.address))

    # Time

    def wait(self, number: int) -> None:
        until_ns = self.now_ns + WAITS_NS[number % 6]
        calls = 0
        while (due_ns := self.leader.next_timer()) <= until_ns:
            self.now_ns = max(self.now_ns, due_ns)
            self._handle_timer()
            calls += 1
            assert calls < 25, "it never sleeps"
        self.now_ns = until_ns

    def _silent_ns(self, name: str) -> int:
        """When a member has been silent for too long; a relay that is here speaks for those below it."""
        of, present = self.known[name], sum(map(self._is_here, self.known))
        gate = self.known.get(of.via or "")
        heard_ns = max(of.heard_ns, gate.heard_ns) if gate is not None and not gate.lost else of.heard_ns
        unreported_ns = CLIENT_UNREPORTED_NS + present * UNREPORTED_PER_CLIENT_NS
        return min(heard_ns + CLIENT_SILENT_NS, of.heard_ns + unreported_ns)

    def _handle_timer(self) -> None:
        silent = [name for name in self.known if self._is_here(name) and self.now_ns >= self._silent_ns(name)]
        over = [
            name for name, of in self.known.items() if of.lost and self.now_ns - of.heard_ns >= FORGET_LOST_NS
        ]
        self.leader.handle_timer(self.now_ns)
        for name in silent:
            of = self.known[name]
            texts = [f"silent for {seconds} s" for seconds in range(2, (self.now_ns - of.heard_ns) // S + 1)]
            actual = self.leader.roster.members.get(name)
            assert actual is None or actual.lost in texts
            self._lose(name, texts[0] if actual is None else actual.lost)
        for name in over:
            self._forget(name)

    # What the leader says

    def _take_sent(self, now_ns: int) -> Sequence[tuple[object, Address]]:
        sent = [(decode(data), address) for data, address in self.leader.datagrams_to_send(now_ns)]
        replies = [message for message in sent if isinstance(message[0], TimeReply)]
        assert sorted(map(str, sent[len(replies) :])) == sorted(map(str, self.sent))
        self.sent = []
        return sent

    def check(self) -> None:
        self._take_sent(self.now_ns)
        events = list(iter(self.leader.next_event, None))
        assert Counter(events) == Counter(self.events)
        self.events = []
        roster = self.leader.roster
        assert self.leader.impostures == self.impostures
        members = {member.name: member for member in roster.by_name()}
        assert [*members] == sorted(self.known)
        for name, of in self.known.items():
            member = members[name]
            assert (member.lost, member.report.state, member.report.frames) == (of.lost, of.state, of.frames)
            assert (member.address, member.via, member.number) == (of.address, of.via, of.number)
            assert (member.has_taken, member.camera.exposure_ns) == (of.has_taken, of.exposure_ns)
            assert roster.member_by_number(of.number) == (None if of.lost else member)
        here = [name for name in self.known if self._is_here(name)]
        assert roster.present_count == len(here)
        assert roster.pollers == sum(self.known[name].via is None for name in here)
        cameras = sorted(name for name in here if name in "ab")
        assert [of.name for of in roster.cameras()] == [n for n in cameras if self.known[n].is_confirmed]
        assert [of.name for of in roster.cameras(even_unconfirmed=True)] == cameras
        assert all(roster.member_by_number(number) is None for number in self.former)
        # A member below a relay is judged by the number of those present, too, now and then.
        due_ns = [
            of.heard_ns + (FORGET_LOST_NS if of.lost else CLIENT_SILENT_NS)
            for of in self.known.values()
            if of.lost or of.via is None
        ]
        assert self.leader.next_timer() <= min(due_ns, default=NEVER_NS)


USUAL = ("hello", "hello", "beat", "wait")
OTHERS = (
    "restart",
    "rebind",
    "steal",
    "forge",
    "ask",
    "sign_off",
    "report_loss",
    "speak_late",
    "remove",
    "stop",
)


@settings(max_examples=140)
@given(histories(USUAL, OTHERS, max_steps=40, max_others=4, numbers=8), st.booleans())
def test_each_member_is_known_by_its_own_messages_until_it_is_silent(
    history: list[tuple[str, int]], is_open: bool
) -> None:
    duty = Duty(is_open=is_open)
    for step, number in history:
        getattr(duty, step)(number)
        duty.check()
