"""What a socket needs of an engine."""

from collections.abc import Iterable
from typing import Protocol

Address = tuple[str, int]


class Engine(Protocol):
    """Takes datagrams in and gives those to send, with one timer; all times in ns of the node's own clock."""

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        """Take in one datagram."""

    def datagrams_to_send(self, now_ns: int) -> Iterable[tuple[bytes, Address]]:
        """Return what is due, stamped with `now_ns`."""

    def next_timer(self) -> int | None:
        """Return when to call `handle_timer`."""

    def handle_timer(self, now_ns: int) -> None:
        """Do what has become due."""
