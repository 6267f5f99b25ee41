"""The pump: moves datagrams between a socket and a sans-IO engine, and keeps its one timer.

Receive times are taken as the first thing when a datagram arrives and send times as the last thing
before it leaves, both with the node's own clock: every microsecond between is an error of the clock.
"""

import asyncio
import contextlib
import socket
from collections.abc import Callable, Iterable
from typing import Any, Protocol, cast

from capture_app.errors import NetworkError
from capture_app.net.address import Address

Clock = Callable[[], int]
"""Returns a node's own time in ns."""


class Engine(Protocol):
    """What the pump needs of an engine; all times in ns of the node's own clock."""

    def receive_datagram(self, data: bytes, address: tuple[str, int], now_ns: int) -> None:
        """Take in one datagram."""

    def datagrams_to_send(self, now_ns: int) -> Iterable[tuple[bytes, tuple[str, int]]]:
        """Return what is due, stamped with `now_ns`."""

    def next_timer(self) -> int | None:
        """Return when to call `handle_timer`."""

    def handle_timer(self, now_ns: int) -> None:
        """Do what has become due."""


class UnaddressedEngine(Protocol):
    """An engine that talks to one peer only."""

    def receive_datagram(self, data: bytes, now_ns: int) -> None:
        """Take in one datagram."""

    def datagrams_to_send(self, now_ns: int) -> list[bytes]:
        """Return what is due, stamped with `now_ns`."""

    def next_timer(self) -> int | None:
        """Return when to call `handle_timer`."""

    def handle_timer(self, now_ns: int) -> None:
        """Do what has become due."""


class ToPeer:
    """Gives a client's engine its leader's address: all goes there, nobody else is listened to."""

    def __init__(self, engine: UnaddressedEngine, peer: Address) -> None:
        self._engine = engine
        self._peer = peer
        self.next_timer = engine.next_timer
        self.handle_timer = engine.handle_timer

    def receive_datagram(self, data: bytes, address: tuple[str, int], now_ns: int) -> None:
        """Take in one datagram, if it is the peer's."""
        if address == self._peer:
            self._engine.receive_datagram(data, now_ns)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, tuple[str, int]]]:
        """Return what is due, stamped with `now_ns`."""
        return [(data, self._peer) for data in self._engine.datagrams_to_send(now_ns)]


class Pump(asyncio.DatagramProtocol):
    """Runs an engine over a UDP socket; `after_turn` is called whenever it may have news."""

    def __init__(self, engine: Engine, clock: Clock, after_turn: Callable[[], None]) -> None:
        self._engine = engine
        self._clock = clock
        self._after_turn = after_turn
        self._transport: asyncio.DatagramTransport | None = None
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin."""
        # asyncio's own datagram transport is not declared as one.
        self._transport = cast(asyncio.DatagramTransport, transport)
        self.turn()

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        """Stamp a datagram and hand it to the engine."""
        now_ns = self._clock()
        self._engine.receive_datagram(data, (addr[0], addr[1]), now_ns)
        self.turn()

    def error_received(self, exc: Exception) -> None:
        """Do nothing: an unreachable peer is one that stays silent, and the engine notices silence."""

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the timer."""
        self._transport = None
        if self._timer is not None:
            self._timer.cancel()

    def turn(self) -> None:
        """Send what is due, publish what is new, and re-arm the timer."""
        if self._transport is None:
            return
        for data, address in self._engine.datagrams_to_send(self._clock()):
            self._transport.sendto(data, address)
        self._after_turn()
        if self._timer is not None:
            self._timer.cancel()
        due_ns = self._engine.next_timer()
        if due_ns is not None and self._transport is not None:
            wait_s = max(0, due_ns - self._clock()) / 1e9
            self._timer = asyncio.get_running_loop().call_later(wait_s, self._tick)

    def close(self) -> None:
        """Let what was sent last leave, then close the socket."""
        if self._transport is not None:
            self._transport.close()

    def _tick(self) -> None:
        self._engine.handle_timer(self._clock())
        self.turn()


async def start_pump(pump: Pump, sock: socket.socket) -> None:
    """Run a pump over a bound, non-blocking UDP socket, which it then owns."""
    # A burst of datagrams must not be lost while the loop is busy; the kernel may allow less.
    with contextlib.suppress(OSError):
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    await asyncio.get_running_loop().create_datagram_endpoint(lambda: pump, sock=sock)


def client_socket(family: socket.AddressFamily) -> socket.socket:
    """Return an unbound UDP socket for a client. Raises NetworkError where there is no such network."""
    try:
        sock = socket.socket(family, socket.SOCK_DGRAM)
    except OSError as error:
        raise NetworkError(f"no {family.name} network here: {error.strerror}") from error
    # Not connected: each datagram takes the route of the moment, so that a change of network is survived.
    sock.setblocking(False)
    return sock
