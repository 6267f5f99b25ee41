"""A client and all whom it may join: the next one where its leader is gone, a better one when it is back."""

from typing import Generic, TypeVar

from capture_app.sync.client import HELLOS, Client
from capture_app.sync.messages import NOBODY, Unknown, WireError, decode
from capture_app.sync.way_back import WayBack

F = TypeVar("F")

Address = tuple[str, int]


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
        if self._client.hellos > HELLOS:
            self._turn = (self._turn + 1) % len(self._leaders)
            self._client.hellos = 1
            self._back = False
        if self._client.is_member and now_ns >= self._way_back.due_ns:
            better = self._way_back.look(self.leader, now_ns, alone=self._client.leader_is_alone)
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
        if self._client.is_member is self._was_member:
            return
        self._was_member = self._client.is_member
        if self._was_member:
            self._way_back.follow(now_ns, back=self._back)
        else:
            self._way_back.lose(self.leader, now_ns)


def _is_there(data: bytes) -> bool:
    try:
        message = decode(data)
    except WireError:
        return False
    return isinstance(message, Unknown) and message.client == NOBODY
