"""A client and all whom it may join: when its leader or relay is gone, the next one is asked."""

from typing import Generic, TypeVar

from capture_app.sync.client import HELLOS, Client

F = TypeVar("F")

Address = tuple[str, int]


class Candidates(Generic[F]):
    """Gives a client's engine the address of the one it follows, or asks: nobody else is listened to.

    `leaders`, the best one first, must lead to the same root; `now_ns` is the client's own clock.
    """

    def __init__(self, client: Client[F], leaders: tuple[Address, ...]) -> None:
        self._client = client
        self._leaders = leaders
        self._turn = 0
        self.next_timer = client.next_timer

    @property
    def leader(self) -> Address:
        """Whom the client follows, or asks at present."""
        return self._leaders[self._turn]

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        """Take in a datagram that arrived at `now_ns`."""
        if address == self.leader:
            self._client.receive_datagram(data, now_ns)

    def handle_timer(self, now_ns: int) -> None:
        """Do what is due; call it at `next_timer`, or any time."""
        self._client.handle_timer(now_ns)
        if self._client.hellos > HELLOS:
            self._turn = (self._turn + 1) % len(self._leaders)
            self._client.hellos = 1

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return datagrams and where to; a time request carries `now_ns`, so send them at once."""
        return [(data, self.leader) for data in self._client.datagrams_to_send(now_ns)]
