"""Pump between a UDP socket and a sans-IO engine, with the engine's single timer.

Send times are read immediately before a datagram leaves. Receive times are the kernel's own timestamps,
converted to the node's clock; a busy process or machine cannot delay them. Each microsecond in between would
be a clock error.
"""

import asyncio
import contextlib
import socket
import time
from collections.abc import Callable

from capture_app.common import system
from capture_app.common.address import Address
from capture_app.common.clock import NodeClock
from capture_app.common.errors import NetworkError
from capture_app.common.host_clock import host_from_monotonic
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.sync_engine import Engine

Reading = Callable[[], int]
"""Returns the reading of a host clock, in ns."""
MAX_BYTES = 2048
MAX_ROUND = 64
"""Maximum number of datagrams in one turn of the loop, so that a flood cannot starve the rest of the node."""
LATE_NS = 100_000_000
"""A timer that is later makes the pump look for events first: the machine may have slept."""


class ReceiptTimes:
    """Conversion of kernel timestamps to a node's local time: possibly late, never early.

    A minimum-delay filter tolerates a late timestamp; an early one would violate the hard bound. The
    timestamps are CLOCK_REALTIME, which runs like CLOCK_MONOTONIC but steps when it is set or the host slept.
    So a timestamp is converted by a pair of readings from before the datagram arrived and by one from after
    it. A step makes one of the two results early, and the later one counts. A node's clock may run at another
    rate than the host's, so it converts that moment itself, instead of subtracting an age from its reading.
    """

    def __init__(
        self,
        clock: NodeClock,
        *,
        realtime: Reading | None = None,
        monotonic: Reading | None = None,
        host: Callable[[int], int] = host_from_monotonic,
    ) -> None:
        """The readings are this host's unless given; `host` converts CLOCK_MONOTONIC to its clock."""
        self._clock, self._host_from_monotonic = clock, host
        # Looked up now, so that a simulation of time can be in their place.
        self._realtime, self._monotonic = realtime or time.time_ns, monotonic or system.monotonic_ns
        self._before = self._after = self._read()

    def received_ns(self, real_ns: int | None, monotonic_ns: int | None = None) -> int:
        """Return the local time in ns of the datagram just read, from its stamp of one clock; else now."""
        self._after = self._read()
        now_ns = self._after[1]
        if real_ns is not None:
            pairs = (self._before, self._after)
            now_ns = min(now_ns, max(mono_ns + real_ns - then_ns for then_ns, mono_ns in pairs))
        elif monotonic_ns is not None:
            now_ns = min(now_ns, monotonic_ns)
        return self._clock.local_from_true(self._host_from_monotonic(now_ns))

    def queue_was_empty(self) -> None:
        """Note that the receive queue was empty: later datagrams arrive after the last reading."""
        self._before = self._after

    def _read(self) -> tuple[int, int]:
        # In this order, so that a delay between the two readings makes the time late, not early.
        real_ns = self._realtime()
        return real_ns, self._monotonic()


class SinglePeerEngine:
    """Adapter for an engine with one peer at a fixed address; datagrams from others are ignored."""

    def __init__(self, engine: TimeClient, peer: Address) -> None:
        self._engine, self._peer = engine, peer
        self.next_timer = engine.next_timer
        self.handle_timer = engine.handle_timer

    def receive_datagram(self, data: bytes, address: tuple[str, int], now_ns: int) -> None:
        """Pass on one datagram if it comes from the peer."""
        if address == self._peer:
            self._engine.receive_datagram(data, now_ns)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, tuple[str, int]]]:
        """Return the datagrams that are due, timestamped with `now_ns`."""
        return [(data, self._peer) for data in self._engine.datagrams_to_send(now_ns)]


class Pump:
    """Driver of an engine over a UDP socket; `after_flush` is called whenever there may be new events."""

    def __init__(self, engine: Engine, clock: NodeClock, after_flush: Callable[[], None]) -> None:
        self._engine, self._clock, self._after_flush = engine, clock.now_ns, after_flush
        self._receipt_times = ReceiptTimes(clock)
        self._loop: asyncio.AbstractEventLoop
        self._end_receiving: Callable[[], object]
        self._socket: socket.socket | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._due_ns: int | None = None
        """Local time in ns for which the timer is set."""

    def start(self, sock: socket.socket) -> None:
        """Run over a non-blocking UDP socket, which the pump then owns."""
        # A burst of datagrams must not be lost while the loop is busy; the kernel may grant less.
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self._socket = sock
        self._loop = asyncio.get_running_loop()
        self._end_receiving = system.receive_datagrams(
            sock, MAX_BYTES, self._received, self._receipt_times.queue_was_empty, at_once=MAX_ROUND
        )
        self.turn()

    def turn(self) -> None:
        """Send what is due, publish new events, and re-arm the timer."""
        if self._socket is None:
            return
        send = self._socket.sendto
        for data, address in self._engine.datagrams_to_send(self._clock()):
            # A datagram that cannot leave counts as lost in transit; an unreachable peer, as a silent one.
            try:  # noqa: SIM105 - a context would cost time between the clock and the socket
                send(data, address)
            except OSError:
                pass
        self._after_flush()
        due_ns = self._engine.next_timer()
        if due_ns == self._due_ns:
            return
        self._due_ns = due_ns
        if self._timer is not None:
            self._timer.cancel()
        if due_ns is not None and self._socket is not None:
            self._timer = self._loop.call_later(max(0, due_ns - self._clock()) / 1e9, self._tick)

    def close(self) -> None:
        """Stop, and close the socket. Calling it twice is harmless."""
        if self._timer is not None:
            self._timer.cancel()
        if self._socket is not None:
            self._end_receiving()
            self._socket.close()
            self._socket = None

    def _tick(self) -> None:
        due_ns, self._due_ns = self._due_ns, None
        if due_ns is not None and self._clock() > due_ns + LATE_NS:
            self._after_flush()
        self._engine.handle_timer(self._clock())
        self.turn()

    def _received(
        self, data: bytes, address: tuple[str, int], real_ns: int | None, monotonic_ns: int | None
    ) -> None:
        self._engine.receive_datagram(data, address, self._receipt_times.received_ns(real_ns, monotonic_ns))
        self.turn()


def client_socket(family: socket.AddressFamily) -> socket.socket:
    """Return an unbound UDP socket for a client. Raises NetworkError where there is no such network."""
    try:
        sock = socket.socket(family, socket.SOCK_DGRAM)
    except OSError as error:
        raise NetworkError(
            f"no {family.name} network here: {error.strerror}",
            hint="give the leader's address of the other kind: IPv4 instead of IPv6, or the reverse",
        ) from error
    # Not connected: each datagram takes the current route, so that a change of network is survived.
    sock.setblocking(False)
    return sock
