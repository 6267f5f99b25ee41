"""The members of a relay as its parent knows them: what they say goes up, what they are told comes down.

Towards the parent a relay speaks for each of its members in the member's own words, so that the root has
one roster of the whole tree, and orders and weighs all cameras alike, however deep. Nothing is repeated here:
what goes unanswered, the members and the root say again.
"""

from collections import deque

from msgspec.structs import replace

from capture_app.sync.rig.roster import MAX_CLIENTS, Member
from capture_app.sync.wire.codec import encode
from capture_app.sync.wire.messages import CLOCK_ONLY, ControlMessage, Goodbye, Heartbeat, Hello, TriggerAck
from capture_app.sync.wire.time_messages import WireError

TOO_LONG = "what it tells of its camera is too long for a relay to pass on"


class Uplink:
    """Which member is known to the parent, by which number; a node that only keeps the time never is."""

    def __init__(self, relay: str, most_members: int = MAX_CLIENTS) -> None:
        """`relay` is the name of the relay whose members these are."""
        self.has_parent = False
        """Whether there is a parent at present."""
        self._relay, self._most_members = relay, most_members
        self._numbers: dict[str, tuple[Member, int]] = {}
        self._members: dict[int, Member] = {}
        self._asking: dict[int, Hello] = {}
        self._refused: dict[int, str] = {}
        self._outbox: deque[bytes] = deque()

    def restart(self, *, has_parent: bool) -> None:
        """Another parent, or none: nobody is known there."""
        self.has_parent = has_parent
        for known in (self._numbers, self._members, self._asking, self._refused, self._outbox):
            known.clear()

    @property
    def remembered(self) -> int:
        """How many clients are remembered that the parent has not taken in."""
        return len(self._asking) + len(self._refused)

    # Up

    def refusal(self, hello: Hello) -> str:
        """Return why a client cannot be here, empty if it can; a parent that refused it is asked again."""
        try:
            encode(self._passed_on(hello))
        except WireError:
            return TOO_LONG
        reason = self._refused.get(hello.instance, "")
        if reason:
            self._ask(hello)
        return reason

    def pass_up(self, member: Member, message: Hello | Heartbeat | TriggerAck | Goodbye) -> bool:
        """Pass on what a member said; whether its answer is to come from above."""
        if not self.has_parent or member.camera.kind == CLOCK_ONLY:
            return False
        known, number = self._numbers.get(member.name, (None, 0))
        if isinstance(message, Hello) or known is not member:
            self._ask(Hello(member.name, member.instance, member.camera, member.via))
            return False
        return self._send(replace(message, client=number)) and isinstance(message, Heartbeat)

    def datagrams_to_send(self) -> list[bytes]:
        """Return what goes to the parent."""
        datagrams = list(self._outbox)
        self._outbox.clear()
        return datagrams

    # Down

    def member(self, number: int) -> Member | None:
        """Return whom the parent means by a number."""
        member = self._members.get(number)
        return None if member is None or member.lost else member

    def note_welcome(self, instance: int, number: int, members: dict[str, Member]) -> None:
        """The parent took a member in, or one that had been refused before and may ask again."""
        hello = self._asking.pop(instance, None)
        self._refused.pop(instance, None)
        member = None if hello is None else members.get(hello.name)
        if member is not None and member.instance == instance and not member.lost:
            self._numbers[member.name] = member, number
            self._members[number] = member

    def note_refusal(self, instance: int, reason: str, members: dict[str, Member]) -> Member | None:
        """The parent did not take a client in; return the member to be given up for it."""
        hello = self._asking.pop(instance, None)
        if hello is None:
            return None
        if len(self._refused) >= self._most_members:
            self._refused.clear()
        self._refused[instance] = reason
        member = members.get(hello.name)
        return member if member is not None and member.instance == instance and not member.lost else None

    def note_unknown(self, number: int) -> None:
        """The parent knows nobody by that number any more: it is asked again when the member speaks."""
        member = self._members.pop(number, None)
        if member is not None:
            self._numbers.pop(member.name, None)

    def _ask(self, hello: Hello) -> None:
        if len(self._asking) >= self._most_members:
            # Nobody answers, or somebody makes names up: whoever is still there says hello again.
            self._asking.clear()
        self._asking[hello.instance] = hello
        self._send(self._passed_on(hello))

    def _passed_on(self, hello: Hello) -> Hello:
        return replace(hello, via=hello.via or self._relay)

    def _send(self, message: ControlMessage) -> bool:
        try:
            self._outbox.append(encode(message))
        except WireError:
            return False
        return True
