"""Summary of a relay's members for its parent: batched reports upward, answers routed back to members.

The root keeps one roster of the whole tree and treats every camera alike, at any depth. A relay announces
each member to its parent once and answers member heartbeats itself. Reports travel upward in batches, so the
number of messages does not grow with the number of members.
"""

from msgspec.structs import replace

from capture_app.common.node_state import CLOCK_ONLY
from capture_app.sync.rig.roster import MAX_CLIENTS, Member
from capture_app.sync.timekeeping.poll_schedule import AT_ONCE_NS, NEVER_NS
from capture_app.sync.wire.codec import WireError, encode
from capture_app.sync.wire.datagrams import (
    MAX_OTHERS,
    MAX_REPORTS,
    ControlMessage,
    Heartbeat,
    Hello,
    MemberReports,
    Report,
    TriggerAck,
)

REPORT_INTERVAL_NS = 250_000_000
"""Interval between batches of member reports; a batch fills at most one datagram."""
ACK_BATCH_NS = 10_000_000
"""Time for which burst acknowledgements are collected before they are sent together."""
DESCRIPTION_TOO_LONG = "the camera's description is too long for a relay to forward"
"""Reason of a refusal: the hello would be over MAX_DATAGRAM with the relay's name in it."""


class RelaySummary:
    """Members of a relay by the numbers that its parent assigned; clock-only nodes are left out."""

    def __init__(self, relay: str, max_members: int = MAX_CLIENTS) -> None:
        """Create an empty summary; `relay` is the name of the relay."""
        self._relay, self._max_members = relay, max_members
        self.restart(has_parent=False)

    def restart(self, *, has_parent: bool) -> None:
        """Reset for another parent, or none: it knows no member yet."""
        self._has_parent = has_parent
        self._numbers: dict[str, tuple[Member, int]] = {}
        self._members: dict[int, Member] = {}
        self._introduced: dict[int, Hello] = {}
        self._refused: dict[tuple[str, str | int], str] = {}
        """Parent's reason for each rejected client, by name and machine pin; by name and instance on an open
        rig.
        """
        self._reports: dict[int, Report] = {}
        """Newest unsent report of each member, by its number at the parent; longest waiting first."""
        self._lost: dict[int, Report] = {}
        """Last report of each earlier instance of a member, until the parent confirms that it no longer knows
        it.
        """
        self._reported: dict[int, tuple[str, bool]] = {}
        """State last sent for each member; a change of it is reported at once."""
        self._report_due_ns, self._acks_due_ns = AT_ONCE_NS if has_parent else NEVER_NS, NEVER_NS
        self._acks: dict[tuple[int, int, str], list[int]] = {}
        """Numbers at the parent of the members that acknowledged, by leader, burst and refusal."""
        self._outbox: list[bytes] = []

    # Up

    def refusal(self, hello: Hello) -> str:
        """Return why a client cannot join, empty if it can; ask a parent that refused it again."""
        try:
            encode(self._with_relay(hello))
        except WireError:
            return DESCRIPTION_TOO_LONG
        if reason := self._refused.get(_who(hello), ""):
            self.ask(hello)
        return reason

    def pass_up(self, member: Member, message: Hello | Heartbeat | TriggerAck, now_ns: int) -> bool:
        """Forward a member's message; return whether its state changed, which the root must know first."""
        if not self._has_parent or member.camera.kind == CLOCK_ONLY:
            return False
        known, number = self._numbers.get(member.name, (None, 0))
        if isinstance(message, Hello) or known is not member:
            if known is not member:
                self.note_unknown(number)
            if known is not None and known.instance != member.instance:
                self._lost[number] = known.report
            self.ask(Hello(member.name, member.instance, member.camera, member.via, member.pin))
        elif isinstance(message, TriggerAck):
            self._acks.setdefault((message.leader, message.burst, message.refusal), []).append(number)
            self._acks_due_ns = min(self._acks_due_ns, now_ns + ACK_BATCH_NS)
        else:
            self._reports[number] = message.report
            return self._reported.get(number) != _stage(message.report)
        return False

    def next_timer(self) -> int:
        """Local time in ns at which `handle_timer` is due."""
        return min(self._acks_due_ns, self._report_due_ns)

    def handle_timer(self, now_ns: int) -> None:
        """Send the batches that are due."""
        if now_ns >= self._acks_due_ns:
            self._acks_due_ns = NEVER_NS
            for (leader, burst, refusal), numbers in self._acks.items():
                batch_size = MAX_OTHERS // 4 if refusal else MAX_OTHERS
                for i in range(0, len(numbers), batch_size):
                    client, *others = numbers[i : i + batch_size]
                    self._send(TriggerAck(client, leader, burst, refusal, tuple(others)))
            self._acks.clear()
        if now_ns >= self._report_due_ns:
            self._report_due_ns = now_ns + REPORT_INTERVAL_NS
            self._sum_up()

    def _sum_up(self) -> None:
        """Send all changed states, and as many of the other reports as fit into one datagram."""
        # The parent confirms a lost or replaced member by answering that it is unknown.
        lost_members = self._lost | {
            number: member.report for member, number in self._numbers.values() if member.lost
        }
        reports = self._reports | lost_members
        changed = {
            n: r for n, r in reports.items() if n in lost_members or self._reported.get(n) != _stage(r)
        }
        due = list((changed | reports).items())
        first, batch_size = 0, MAX_REPORTS
        while first < min(len(due), max(1, len(changed))):
            while not self._send(MemberReports(tuple(due[first : first + batch_size]))):
                batch_size //= 2
            for number, report in due[first : first + batch_size]:
                self._reports.pop(number, None)
                self._reported[number] = _stage(report)
            first += batch_size

    def datagrams_to_send(self) -> list[bytes]:
        """Return the datagrams for the parent."""
        datagrams, self._outbox = self._outbox, []
        return datagrams

    # Down

    def member(self, number: int) -> Member | None:
        """Return the present member with this number at the parent, or None."""
        member = self._members.get(number)
        return None if member is None or member.lost else member

    def note_welcome(self, instance: int, number: int, members: dict[str, Member]) -> Member | None:
        """Note that the parent admitted a member, or a client that was refused before.

        Return the member here that uses the same name and belongs to another machine, or None.
        """
        if (hello := self._introduced.pop(instance, None)) is None:
            return None
        self._refused.pop(_who(hello), None)
        member = members.get(hello.name)
        if member is not None and member.instance == instance and not member.lost:
            self._numbers[member.name] = member, number
            self._members[number] = member
            if member.is_confirmed:
                self._reports[number] = member.report
        return member if member is not None and member.is_of_another_machine(hello) else None

    def note_refusal(self, instance: int, reason: str, members: dict[str, Member]) -> Member | None:
        """Note that the parent refused a client; return the member to be dropped, or None."""
        if (hello := self._introduced.pop(instance, None)) is None:
            return None
        if len(self._refused) >= self._max_members:
            self._refused.clear()
        self._refused[_who(hello)] = reason
        member = members.get(hello.name)
        if member is None or member.instance != instance or member.lost:
            return None
        # Another machine may have sent the same instance number: its refusal concerns no member.
        return None if member.is_of_another_machine(hello) else member

    def note_unknown(self, number: int) -> None:
        """Note that the parent no longer knows a number: the member is announced again."""
        for known in (self._reports, self._lost, self._reported):
            known.pop(number, None)
        member = self._members.pop(number, None)
        if member is not None and self._numbers.get(member.name) == (member, number):
            del self._numbers[member.name]

    def ask(self, hello: Hello) -> None:
        """Ask the parent whether a client may join; its answer overrides the owner of the name here."""
        if len(self._introduced) >= self._max_members:
            # No answers, or made-up names: real clients send further hellos.
            self._introduced.clear()
        self._introduced[hello.instance] = hello
        self._send(self._with_relay(hello))

    def _with_relay(self, hello: Hello) -> Hello:
        return replace(hello, via=hello.via or self._relay)

    def _send(self, message: ControlMessage) -> bool:
        try:
            self._outbox.append(encode(message))
        except WireError:
            return False
        return True


def _stage(report: Report) -> tuple[str, bool]:
    """Return the state on which the root acts at once, and whether the phase is unknown."""
    return report.state, report.frame_leader_ns is None


def _who(hello: Hello) -> tuple[str, str | int]:
    return hello.name, hello.pin or hello.instance
