"""A client and all whom it may join: the next one where its leader is gone, a better one when it is back."""

from typing import Generic, TypeVar

from capture_app.sync.client import HELLOS, Client
from capture_app.sync.messages import NOBODY, Heartbeat, Report, Unknown, WireError, decode, encode
from capture_app.sync.state import NodeState

F = TypeVar("F")

Address = tuple[str, int]

LOOK_EVERY_NS = 5_000_000_000
PROOFS = 2
"""Looks that a better leader has to answer in a row: one that comes and goes is none."""
_LOOK = encode(Heartbeat(NOBODY, Report(state=NodeState.JOINING)))


class Candidates(Generic[F]):
    """Gives a client's engine the address of the one it follows, or asks: nobody else is listened to.

    `leaders`, the best one first, must lead to the same root; `now_ns` is the client's own clock. A relay
    that has lost its own leader is worse than any that has one.
    """

    def __init__(self, client: Client[F], leaders: tuple[Address, ...]) -> None:
        self._client = client
        self._leaders = leaders
        self._turn = 0
        self._look_due_ns: int | None = None
        self._looks: list[Address] = []
        self._proofs: dict[Address, int] = {}
        """Of those that were looked for: how often each has answered in a row."""
        self._answered: set[Address] = set()

    @property
    def leader(self) -> Address:
        """Whom the client follows, or asks at present."""
        return self._leaders[self._turn]

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        """Take in a datagram that arrived at `now_ns`."""
        if address == self.leader:
            self._client.receive_datagram(data, now_ns)
        elif address in self._proofs and _is_there(data):
            self._answered.add(address)

    def handle_timer(self, now_ns: int) -> None:
        """Do what is due; call it at `next_timer`, or any time."""
        self._client.handle_timer(now_ns)
        if self._client.hellos > HELLOS:
            self._turn = (self._turn + 1) % len(self._leaders)
            self._client.hellos = 1
        if len(self._leaders) > 1 and now_ns >= (self._look_due_ns or now_ns):
            self._look_due_ns = now_ns + LOOK_EVERY_NS
            self._look(now_ns)

    def next_timer(self) -> int:
        """Local time in ns at which `handle_timer` wants to be called."""
        due_ns = self._client.next_timer()
        return due_ns if self._look_due_ns is None else min(due_ns, self._look_due_ns)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return datagrams and where to; a time request carries `now_ns`, so send them at once."""
        datagrams = [(data, self.leader) for data in self._client.datagrams_to_send(now_ns)]
        datagrams += [(_LOOK, address) for address in self._looks]
        self._looks.clear()
        return datagrams

    def _look(self, now_ns: int) -> None:
        """Change to a better leader that has proven to be there, and look for all who would be better."""
        better = self._better()
        proofs = {a: self._proofs.get(a, 0) + 1 if a in self._answered else 0 for a in better}
        found = next((address for address in better if proofs[address] >= PROOFS), None)
        if found is not None and self._client.may_change:
            self._turn = self._leaders.index(found)
            self._client.change_leader("a better one is there", now_ns)
            better, proofs = (), {}
        self._looks, self._proofs = list(better), proofs
        self._answered.clear()

    def _better(self) -> tuple[Address, ...]:
        if self._client.state is not NodeState.READY:
            return ()
        if self._client.leader_is_alone:
            return tuple(address for address in self._leaders if address != self.leader)
        return self._leaders[: self._turn]


def _is_there(data: bytes) -> bool:
    try:
        message = decode(data)
    except WireError:
        return False
    return isinstance(message, Unknown) and message.client == NOBODY
