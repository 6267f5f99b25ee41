"""The listening end of the phones' server: strangers take little of it, and not for long."""

import asyncio
import contextlib
import socket
import ssl
import time
from collections.abc import Iterable

from aiohttp import web

MOST_STRANGERS = 128
"""Connections open at a time that are no phone's link; the newest beyond are closed."""
STRANGER_S = 20.0
"""One that has not become a link by then is closed: no page takes so long to load."""
HANDSHAKE_S = 10.0
LOOK_EVERY_S = 0.5


class Door:
    """Accepts connections for a web server, and closes those that stay without being trusted."""

    def __init__(self, server: web.Server) -> None:
        self._web = server
        self._server: asyncio.Server | None = None
        self._sweeping: asyncio.Task[None] | None = None
        self._since_s: dict[asyncio.BaseTransport, float] = {}
        self._trusted: set[asyncio.BaseTransport] = set()
        self._stamped: dict[asyncio.BaseTransport, _StampedProtocol] = {}

    def received_ns(self, transport: asyncio.BaseTransport | None) -> int:
        """Return when bytes came last on a connection, by the monotonic clock: perhaps late, never early."""
        stamped = self._stamped.get(transport) if transport is not None else None
        return time.monotonic_ns() if stamped is None else stamped.received_ns

    async def open(self, listening: socket.socket, tls: ssl.SSLContext | None) -> None:
        """Accept what comes on a socket that listens."""
        self._server = await asyncio.get_running_loop().create_server(
            lambda: _StampedProtocol(self._web(), self._stamped),
            sock=listening,
            ssl=tls,
            ssl_handshake_timeout=None if tls is None else HANDSHAKE_S,
        )
        self._sweeping = asyncio.create_task(self._sweep())

    def trust(self, transport: asyncio.BaseTransport | None) -> None:
        """Let a connection stay: it is a phone's that was let in."""
        if transport is not None:
            self._trusted.add(transport)

    async def close(self) -> None:
        """Accept nothing more."""
        if self._server is not None:
            self._server.close()
        if self._sweeping is not None:
            self._sweeping.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._sweeping

    async def _sweep(self) -> None:
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            now_s = asyncio.get_running_loop().time()
            open_now = {one.transport for one in self._web.connections if one.transport is not None}
            self._trusted &= open_now
            known = self._since_s
            self._since_s = {one: known.get(one, now_s) for one in open_now - self._trusted}
            oldest_first = sorted(self._since_s, key=self._since_s.__getitem__)
            late = [one for one in oldest_first if now_s - self._since_s[one] >= STRANGER_S]
            _abort((*late, *oldest_first[MOST_STRANGERS:]))


class _StampedProtocol(asyncio.Protocol):
    """Notes when bytes come, before the task that they are for is woken up, and hands all on."""

    def __init__(
        self, handler: asyncio.Protocol, open_now: "dict[asyncio.BaseTransport, _StampedProtocol]"
    ) -> None:
        self.received_ns = 0
        self._handler, self._open_now = handler, open_now
        self._transport: asyncio.BaseTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport
        self._open_now[transport] = self
        self._handler.connection_made(transport)

    def data_received(self, data: bytes) -> None:
        self.received_ns = time.monotonic_ns()
        self._handler.data_received(data)

    def eof_received(self) -> bool | None:
        return self._handler.eof_received()

    def pause_writing(self) -> None:
        self._handler.pause_writing()

    def resume_writing(self) -> None:
        self._handler.resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        if self._transport is not None:
            self._open_now.pop(self._transport, None)
        self._handler.connection_lost(exc)


def _abort(transports: Iterable[asyncio.BaseTransport]) -> None:
    for transport in transports:
        if isinstance(transport, asyncio.WriteTransport):
            transport.abort()
