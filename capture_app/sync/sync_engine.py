"""Interface between a socket and a protocol engine."""

from collections.abc import Iterable
from typing import Protocol

Address = tuple[str, int]


class Engine(Protocol):
    """Protocol engine without a socket: datagrams in and out, one timer; times in ns of the node's clock."""

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        """Process one datagram."""

    def datagrams_to_send(self, now_ns: int) -> Iterable[tuple[bytes, Address]]:
        """Return the datagrams that are due, with their destinations; time messages carry `now_ns`."""

    def next_timer(self) -> int | None:
        """Return the local time at which `handle_timer` is to be called; None if never."""

    def handle_timer(self, now_ns: int) -> None:
        """Run the actions that are due."""
