"""Pump between a UDP socket and a sans-IO engine, with the engine's single timer.

Send times are read immediately before a datagram leaves. Receive times are the kernel's own timestamps,
converted to the node's clock; a busy process or machine cannot delay them. Each microsecond in between would
be a clock error.
"""

import asyncio
import contextlib
import socket
import struct
import time
from collections.abc import Callable, Iterable

from capture_app.common.address import Address
from capture_app.common.clock import NodeClock
from capture_app.common.errors import NetworkError
from capture_app.common.host_clock import host_from_monotonic
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.sync_engine import Engine

# Linux's number, which the socket module lacks; the timestamp is a timespec of CLOCK_REALTIME.
SO_TIMESTAMPNS = 35
_TIMESPEC = struct.Struct("@ll")
ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size)

Reading = Callable[[], int]
"""Returns the reading of a host clock, in ns."""
MAX_BYTES = 2048
MAX_ROUND = 64


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
        self._realtime, self._monotonic = realtime or time.time_ns, monotonic or time.monotonic_ns
        self._before = self._after = self._read()

    def received_ns(self, ancillary: Iterable[tuple[int, int, bytes]]) -> int:
        """Return the local time in ns of the datagram just read; now if the kernel does not report it."""
        self._after = self._read()
        now_ns = self._after[1]
        for level, kind, stamp in ancillary:
            if (level, kind) == (socket.SOL_SOCKET, SO_TIMESTAMPNS) and len(stamp) == _TIMESPEC.size:
                seconds, nanoseconds = _TIMESPEC.unpack(stamp)
                stamp_ns = seconds * 1_000_000_000 + nanoseconds
                placed_ns = max(
                    mono_ns + stamp_ns - real_ns for real_ns, mono_ns in (self._before, self._after)
                )
                now_ns = min(placed_ns, now_ns)
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
        self._socket: socket.socket | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._due_ns: int | None = None
        """Local time in ns for which the timer is set."""

    def start(self, sock: socket.socket) -> None:
        """Run over a non-blocking UDP socket, which the pump then owns."""
        # A burst of datagrams must not be lost while the loop is busy; the kernel may grant less.
        for option, value in ((SO_TIMESTAMPNS, 1), (socket.SO_RCVBUF, 1 << 20)):
            with contextlib.suppress(OSError):
                sock.setsockopt(socket.SOL_SOCKET, option, value)
        self._socket = sock
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(sock.fileno(), self._readable)
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
            self._loop.remove_reader(self._socket.fileno())
            self._socket.close()
            self._socket = None

    def _tick(self) -> None:
        self._due_ns = None
        self._engine.handle_timer(self._clock())
        self.turn()

    def _readable(self) -> None:
        # At most one round per call, so that a flood on the port cannot starve the rest of the node.
        for _ in range(MAX_ROUND):
            if self._socket is None:
                return
            try:
                data, ancillary, _, address = self._socket.recvmsg(MAX_BYTES, ANCILLARY_BYTES)
            except BlockingIOError:
                self._receipt_times.queue_was_empty()
                return
            except OSError:
                # An ICMP error: something was sent to a closed port.
                continue
            self._engine.receive_datagram(
                data, (address[0], address[1]), self._receipt_times.received_ns(ancillary)
            )
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
