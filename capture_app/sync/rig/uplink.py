"""Passes the members' messages of a relay up to its parent, and says which member an answer is for.

A relay sends each member's messages on as they are, so that the root has one roster of the whole tree and
treats all cameras alike, however deep. Nothing is sent again here: members and root do that themselves.
"""

from collections import deque

from msgspec.structs import replace

from capture_app.sync.rig.roster import MAX_CLIENTS, Member
from capture_app.sync.wire.codec import WireError, encode
from capture_app.sync.wire.messages import CLOCK_ONLY, ControlMessage, Goodbye, Heartbeat, Hello, TriggerAck

TOO_LONG = "what it tells of its camera is too long for a relay to pass on"


class Uplink:
    """Knows the parent's number of each member; nodes that only keep the time are not passed up."""

    def __init__(self, relay: str, most_members: int = MAX_CLIENTS) -> None:
        """`relay` is the name of the relay whose members these are."""
        self.has_parent = False
        """Whether there is a parent at present."""
        self._relay, self._most_members = relay, most_members
        self._numbers: dict[str, tuple[Member, int]] = {}
        self._members: dict[int, Member] = {}
        self._introduced: dict[int, Hello] = {}
        self._refused: dict[tuple[str, str | int], str] = {}
        """By name and machine, or the run where the rig asks nobody who it is."""
        self._outbox: deque[bytes] = deque()

    def restart(self, *, has_parent: bool) -> None:
        """Start anew with another parent, or none: no member is known there."""
        self.has_parent = has_parent
        for known in (self._numbers, self._members, self._introduced, self._refused, self._outbox):
            known.clear()

    @property
    def remembered(self) -> int:
        """How many clients are remembered that the parent has not taken in."""
        return len(self._introduced) + len(self._refused)

    # Up

    def refusal(self, hello: Hello) -> str:
        """Return why a client cannot join, empty if it can; a parent that refused it is asked again."""
        try:
            encode(self._with_relay(hello))
        except WireError:
            return TOO_LONG
        reason = self._refused.get(_who(hello), "")
        if reason:
            self.ask(hello)
        return reason

    def pass_up(self, member: Member, message: Hello | Heartbeat | TriggerAck | Goodbye) -> bool:
        """Pass a member's message on; whether the answer comes from the parent."""
        if not self.has_parent or member.camera.kind == CLOCK_ONLY:
            return False
        known, number = self._numbers.get(member.name, (None, 0))
        if isinstance(message, Hello) or known is not member:
            self.ask(Hello(member.name, member.instance, member.camera, member.via, member.pin))
            return False
        return self._send(replace(message, client=number)) and isinstance(message, Heartbeat)

    def datagrams_to_send(self) -> list[bytes]:
        """Return what goes to the parent."""
        datagrams = list(self._outbox)
        self._outbox.clear()
        return datagrams

    # Down

    def member(self, number: int) -> Member | None:
        """Return the member that has this number at the parent."""
        member = self._members.get(number)
        return None if member is None or member.lost else member

    def note_welcome(self, instance: int, number: int, members: dict[str, Member]) -> Member | None:
        """Note that the parent took a member in, or a client that was refused before.

        Return the member of another machine that has its name here.
        """
        hello = self._introduced.pop(instance, None)
        if hello is None:
            return None
        self._refused.pop(_who(hello), None)
        member = members.get(hello.name)
        if member is not None and member.instance == instance and not member.lost:
            self._numbers[member.name] = member, number
            self._members[number] = member
        return member if member is not None and member.is_of_another_machine(hello) else None

    def note_refusal(self, instance: int, reason: str, members: dict[str, Member]) -> Member | None:
        """Note that the parent refused a client; return the member that is to be dropped, if there is one."""
        hello = self._introduced.pop(instance, None)
        if hello is None:
            return None
        if len(self._refused) >= self._most_members:
            self._refused.clear()
        self._refused[_who(hello)] = reason
        member = members.get(hello.name)
        return member if member is not None and member.instance == instance and not member.lost else None

    def note_unknown(self, number: int) -> None:
        """Note that the parent does not know a number any more: the member is introduced again."""
        member = self._members.pop(number, None)
        if member is not None:
            self._numbers.pop(member.name, None)

    def ask(self, hello: Hello) -> None:
        """Ask the parent whether a client may join: its answer counts, whoever has the name here."""
        if len(self._introduced) >= self._most_members:
            # No answers, or made-up names: clients that are there say hello again.
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


def _who(hello: Hello) -> tuple[str, str | int]:
    return hello.name, hello.pin or hello.instance
