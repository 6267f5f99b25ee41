"""A client and all whom it may join: the next one where its leader is gone, a better one when it is back."""

from typing import Generic, TypeVar

from capture_app.sync.rig.client import Client
from capture_app.sync.rig.poll_schedule import NEVER_NS
from capture_app.sync.rig.time_client import HELLOS
from capture_app.sync.wire.codec import decode, encode
from capture_app.sync.wire.messages import PROBE_NUMBER, Heartbeat, NodeState, Report, UnknownMember
from capture_app.sync.wire.time_messages import WireError

Address = tuple[str, int]

LOOK_EVERY_NS = 15_000_000_000
PROOFS, MOST_PROOFS = 4, 64
"""Looks in a row that a better parent has to answer: a minute at first, twice that whenever it fails soon."""
SOON = 4
"""One that then stays for less than so many times as long as it was waited for has failed soon."""
_LOOK = encode(Heartbeat(PROBE_NUMBER, Report(state=NodeState.JOINING)))


class WayBack:
    """Which better parents answer, and for how long; `now_ns` is the node's own clock."""

    def __init__(self, parents: tuple[Address, ...]) -> None:
        self.due_ns = NEVER_NS
        self._parents = parents
        self._needed = dict.fromkeys(parents, PROOFS)
        self._proofs: dict[Address, int] = {}
        """Of those that were looked for last: how often each had answered in a row before."""
        self._answered: set[Address] = set()
        self._looks: list[Address] = []
        self._back_since_ns: int | None = None

    def follow(self, now_ns: int, *, back: bool = False) -> None:
        """A parent has taken this node in; `back` where it was looked for, not asked in turn."""
        self._back_since_ns = now_ns if back else None
        self._forget()
        self.due_ns = now_ns if len(self._parents) > 1 else NEVER_NS

    def lose(self, parent: Address, now_ns: int) -> None:
        """That parent is gone; nobody is looked for until there is another one."""
        if self._back_since_ns is not None:
            soon_ns = SOON * self._needed[parent] * LOOK_EVERY_NS
            soon = now_ns - self._back_since_ns < soon_ns
            self._needed[parent] = min(2 * self._needed[parent], MOST_PROOFS) if soon else PROOFS
        self._forget()
        self.due_ns = NEVER_NS

    def answered(self, address: Address) -> None:
        """Somebody who was looked for is there."""
        if address in self._proofs:
            self._answered.add(address)

    def look(self, parent: Address, now_ns: int, *, in_holdover: bool) -> Address | None:
        """Look for all parents better than the present one; return one that has proven to be there.

        A parent that is alone, without any of its own, is worse than any other, and left at the first answer.
        """
        self.due_ns = now_ns + LOOK_EVERY_NS
        others = tuple(address for address in self._parents if address != parent)
        better = others if in_holdover else self._parents[: self._parents.index(parent)]
        self._proofs = {a: self._proofs.get(a, 0) + 1 if a in self._answered else 0 for a in better}
        self._answered.clear()
        self._looks = list(better)
        return next((a for a in better if self._proofs[a] >= (1 if in_holdover else self._needed[a])), None)

    def datagrams_to_send(self) -> list[tuple[bytes, Address]]:
        """Return what asks whether they are there; no leader takes whoever sends it for a client."""
        if not self._looks:
            return []
        looks, self._looks = self._looks, []
        return [(_LOOK, address) for address in looks]

    def _forget(self) -> None:
        self._proofs.clear()
        self._answered.clear()
        self._looks.clear()


F = TypeVar("F")


class Candidates(Generic[F]):
    """Gives a client's engine the address of the one it follows, or asks: nobody else is listened to.

    `leaders`, the best one first, must lead to the same root; `now_ns` is the client's own clock. A relay
    that has lost its own leader is worse than any that has one.
    """

    def __init__(self, client: Client[F], leaders: tuple[Address, ...]) -> None:
        self._client = client
        self._leaders = leaders
        self._turn = 0
        self._was_member = False
        self._back = False
        """Whether the present leader was looked for, not asked in turn."""
        self._way_back = WayBack(leaders)

    @property
    def leader(self) -> Address:
        """Whom the client follows, or asks at present."""
        return self._leaders[self._turn]

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        """Take in a datagram that arrived at `now_ns`."""
        if address == self.leader:
            self._client.receive_datagram(data, now_ns)
            self._note_membership(now_ns)
        elif _is_there(data):
            self._way_back.answered(address)

    def handle_timer(self, now_ns: int) -> None:
        """Do what is due; call it at `next_timer`, or any time."""
        self._client.handle_timer(now_ns)
        self._note_membership(now_ns)
        if self._client.time.hellos > HELLOS:
            self._turn = (self._turn + 1) % len(self._leaders)
            self._client.time.hellos = 1
            self._back = False
        if self._client.time.is_member and now_ns >= self._way_back.due_ns:
            better = self._way_back.look(self.leader, now_ns, in_holdover=self._client.leader_in_holdover)
            if better is not None and self._client.may_change:
                self._change(better, now_ns)

    def next_timer(self) -> int:
        """Local time in ns at which `handle_timer` wants to be called."""
        return min(self._client.next_timer(), self._way_back.due_ns)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return datagrams and where to; a time request carries `now_ns`, so send them at once."""
        datagrams = [(data, self.leader) for data in self._client.datagrams_to_send(now_ns)]
        return datagrams + self._way_back.datagrams_to_send()

    def _change(self, leader: Address, now_ns: int) -> None:
        self._turn = self._leaders.index(leader)
        self._back = True
        self._client.change_leader("a better leader is there", now_ns)
        self._note_membership(now_ns)

    def _note_membership(self, now_ns: int) -> None:
        if self._client.time.is_member is self._was_member:
            return
        self._was_member = self._client.time.is_member
        if self._was_member:
            self._way_back.follow(now_ns, back=self._back)
        else:
            self._way_back.lose(self.leader, now_ns)


def _is_there(data: bytes) -> bool:
    try:
        message = decode(data)
    except WireError:
        return False
    return isinstance(message, UnknownMember) and message.client == PROBE_NUMBER
