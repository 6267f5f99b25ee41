"""Server of a leader's port, one number for UDP and TCP, with limits for unknown peers."""

import asyncio
import errno
import os
import socket
from collections.abc import Awaitable, Callable, Iterable
from contextlib import suppress
from typing import Any, Generic, TypeVar

import msgspec

from capture_app.common import system
from capture_app.common.address import Address
from capture_app.common.errors import NetworkError, SimulshotError
from capture_app.common.grouping import grouped
from capture_app.common.pairing_codes import Role
from capture_app.common.tasks import end
from capture_app.net.channel import CHUNK_BYTES, Channel, StreamTimeouts
from capture_app.trust.trust import UNKNOWN_PEER, Peer, Trust

M = TypeVar("M")
MAX_STREAMS, MAX_STREAMS_PER_ADDRESS = 768, 384
"""A node has at most two streams open; nodes below a relay share the relay's address."""
MAX_STREAMS_PER_MACHINE = 200
"""Limit for one machine, whose cameras have two streams each, so that it cannot displace others."""
RESERVED = 32
"""Streams beyond the limits, for operators: they are recognized only once they have connected."""
MAX_SILENT = 96
"""Maximum number of streams without a message yet, because TLS allocates memory from the start."""
MAX_FILES = 8192
FILES_OF_A_STREAM, OTHER_FILES = 2, 128
STREAM_TIMEOUTS = StreamTimeouts()
KNOWN_EVERY_S = 1.0
"""Interval between checks of which machines are still known."""


class TransferServer(Generic[M]):
    """Server that accepts streams on a bound socket and passes each to `serve` until it returns.

    A peer that breaks the protocol loses only its own stream. To make room for a new stream the server closes
    the oldest silent one, else the oldest of an unknown peer. Streams of joined nodes stay.
    """

    def __init__(
        self,
        messages: Any,
        serve: Callable[[Channel[M]], Awaitable[None]],
        *,
        max_streams: int = MAX_STREAMS,
        max_per_address: int = MAX_STREAMS_PER_ADDRESS,
        stream_timeouts: StreamTimeouts = STREAM_TIMEOUTS,
        trust: Trust | None = None,
    ) -> None:
        """Limit the open streams to `max_streams`, and apply `stream_timeouts` to each.

        `trust` is this end's identity and known machines, by default its user's.
        """
        self._trust = trust or Trust.of_user()
        self._open: dict[Channel[M], Peer] = {}
        """Open streams, oldest first, with each peer as identified by its key."""
        self._decoder: msgspec.json.Decoder[M] = msgspec.json.Decoder(messages)
        self._serve, self._stream_timeouts = serve, stream_timeouts
        self._server: asyncio.Server | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        """A task for each open stream, and one that watches which machines are known."""
        self._max_streams, self._max_per_address = min(max_streams, allowed_streams()), max_per_address

    async def start(self, listening: socket.socket) -> None:
        """Start accepting streams."""
        self._server = await asyncio.start_server(self._accept, sock=listening, limit=CHUNK_BYTES)
        self._tasks.add(asyncio.create_task(self._watch_known()))

    async def stop(self) -> None:
        """Close the port and every stream."""
        if self._server is not None:
            self._server.close()
        await end(*self._tasks)

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        channel = Channel(reader, writer, self._decoder, self._stream_timeouts)
        if not self._admit(channel):
            channel.abort()
            return
        self._tasks.add(task)
        with suppress(OSError):
            # A peer that was unplugged never closes its stream.
            writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        try:
            async with channel:
                await channel.identify(self._trust)
                if not self._admit_peer(channel):
                    channel.abort()
                    return
                self._open[channel] = channel.who
                await self._serve(channel)
        except (SimulshotError, OSError, asyncio.CancelledError):
            # asyncio's own callback on this task would print a cancellation as an error.
            pass
        finally:
            self._tasks.discard(task)
            self._open.pop(channel, None)

    def _admit(self, stream: Channel[M]) -> bool:
        """Return whether a new stream may stay; another one may be closed to make room."""
        own = [channel for channel in self._open if channel.peer.host == stream.peer.host]
        silent = [channel for channel in self._open if not channel.has_spoken]
        admitted = True
        if len(silent) >= MAX_SILENT:
            admitted = self._make_room(_by_host(silent)[0])
        elif len(own) >= self._max_per_address:
            admitted = self._make_room(own)
        elif len(self._open) >= self._max_streams:
            # The host with the most streams is the likeliest to have too many.
            admitted = any(map(self._make_room, _by_host(self._open)))
        if not admitted and len(self._open) < self._max_streams + RESERVED:
            admitted = stream.is_beyond = True
        if admitted:
            self._open[stream] = UNKNOWN_PEER
        return admitted

    def _admit_peer(self, stream: Channel[M]) -> bool:
        """Return whether an identified stream may stay; another one of its machine may be closed for it."""
        who = stream.who
        if who.pin and (who.may(Role.OPERATOR) or (who.may(Role.RELAY) and not stream.is_beyond)):
            return True
        stays = not stream.is_beyond
        own = [channel for channel in self._open if who.pin and channel.who == who]
        if stays and len(own) > MAX_STREAMS_PER_MACHINE:
            spare = next((channel for channel in own if not channel.is_known), stream)
            self._break_off(spare)
            stays = spare is not stream
        return stays

    def _make_room(self, streams: Iterable[Channel[M]]) -> bool:
        unknown = [
            channel
            for channel in streams
            if not (channel.is_known or (channel.who.pin and channel.who.may(Role.OPERATOR)))
        ]
        stream = next((channel for channel in unknown if not channel.has_spoken), next(iter(unknown), None))
        if stream is not None:
            self._break_off(stream)
        return stream is not None

    def _break_off(self, stream: Channel[M]) -> None:
        stream.abort()
        self._open.pop(stream, None)

    async def _watch_known(self) -> None:
        """Close the streams of machines that were removed or whose roles have changed."""
        while True:
            await asyncio.sleep(KNOWN_EVERY_S)
            # If the file of known machines is damaged at the moment, the next check reads it.
            with suppress(SimulshotError):
                for channel, shown in tuple(self._open.items()):
                    if shown.pin and self._trust.peer_of(shown.pin).roles != shown.roles:
                        channel.abort()


def _by_host(streams: Iterable[Channel[M]]) -> list[list[Channel[M]]]:
    """Group streams by the host of the other end, largest group first."""
    by_machine = grouped((stream.peer.host, stream) for stream in streams)
    return sorted(by_machine.values(), key=len, reverse=True)


def allowed_streams() -> int:
    """Return the number of streams that this process has file descriptors for, after raising its limit."""
    files = system.allow_open_files(MAX_FILES)
    return max(1, min(MAX_STREAMS, (files - OTHER_FILES) // FILES_OF_A_STREAM))


def bind_port(host: str, port: int, *, or_free: bool = False) -> tuple[socket.socket, socket.socket]:
    """Return a UDP and a listening TCP socket on one port number; port 0 selects one that is free for both.

    With `or_free`, any free port is used if the requested one is unavailable.

    Raises NetworkError where the port is in use or the host is not this machine's.
    """
    if or_free:
        with suppress(NetworkError):
            return bind_port(host, port)
        port = 0
    for _ in range(20):
        try:
            stream = _bound(host, port, socket.SOCK_STREAM)
        except OSError as error:
            raise _cannot_listen(host, port, error) from error
        try:
            datagrams = _bound(host, stream.getsockname()[1], socket.SOCK_DGRAM)
        except OSError as error:
            stream.close()
            if port:
                raise _cannot_listen(host, port, error) from error
            continue
        return datagrams, stream
    raise NetworkError(
        f"no port on {host} is free for both UDP and TCP",
        hint="choose one with --port, or close other programs",
    )


def _bound(host: str, port: int, kind: socket.SocketKind) -> socket.socket:
    addresses = socket.getaddrinfo(host or None, port, type=kind, flags=socket.AI_PASSIVE)
    family, _, protocol, _, where = min(addresses, key=lambda entry: entry[0] != socket.AF_INET)
    sock = socket.socket(family, kind, protocol)
    try:
        if kind == socket.SOCK_STREAM:
            # A restarted leader must not wait for the old one's streams to time out.
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.setblocking(False)
        sock.bind(where)
        if kind == socket.SOCK_STREAM:
            sock.listen()
    except OSError:
        sock.close()
        raise
    return sock


def _cannot_listen(host: str, port: int, error: OSError) -> NetworkError:
    address = Address(host, port)
    if isinstance(error, socket.gaierror):
        return NetworkError(f"cannot listen on {address}: {error.strerror}", hint="check the host's name")
    # Windows says that access is denied.
    if error.errno == errno.EADDRINUSE or (os.name == "nt" and isinstance(error, PermissionError)):
        return NetworkError(
            f"cannot listen on {address}: the port is in use",
            hint="another leader may use it: choose another with --port",
        )
    return NetworkError(f"cannot listen on {address}: {error.strerror or error}")
