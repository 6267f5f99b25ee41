"""Web server for phones: the page, their admission, and one link for each phone.

Connections that have not identified themselves get few resources, for a short time.
"""

import asyncio
import contextlib
import functools
import logging
import socket
import ssl
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path

import msgspec
from aiohttp import WSMsgType, web
from aiohttp.http_exceptions import HttpProcessingError
from aiohttp.typedefs import Handler

from capture_app.common.errors import UnknownMachineError
from capture_app.common.tasks import end
from capture_app.common.text import UNREADABLE
from capture_app.common.timeouts import HANDSHAKE_TIMEOUT_S, IDENTIFY_TIMEOUT_S
from capture_app.phones import wire
from capture_app.phones.admission import Admission, Admitted
from capture_app.phones.phone import Phone

MAX_UNKNOWN = 128
"""Max number of open connections without an admitted phone; the newest in excess are closed."""
MAX_GREETED = 64
LOOK_EVERY_S = 0.5
SCRIPTS = ("requirements.js", "controls.js", "opening.js", "page.js", "link.js", "camera.js")
PARTS = {
    "": ("index.html", "text/html"),
    "page.css": ("page.css", "text/css"),
    **{name: (name, "text/javascript") for name in SCRIPTS},
}
DEFAULT_SIZE = (1280, 720)
HEARTBEAT_S = 5.0
HELLO_S = 10.0
LEFT = 1000
"""Close code of a page whose user ends its link."""
REPLACED = 4001
"""Close code for a page that another page of the same phone replaces."""
CLOSE_S = 2.0
"""Timeout of a page's answer to the closing of its link."""
_PUT_OFF = b"The leader has put this phone off. To come back, scan the code that it shows now."
_REPLACED = b"This phone takes part by another page of it. Close one of them."
_POLICY = (
    "default-src 'none'; script-src 'self'; worker-src 'self'; style-src 'self'; img-src data:;"
    " media-src 'self' blob: mediastream:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    # Browsers give precise timers only to a page that is isolated from other origins.
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Embedder-Policy": "require-corp",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(self), screen-wake-lock=(self), microphone=(), geolocation=()",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


def _is_ours(record: logging.LogRecord) -> bool:
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, HttpProcessingError | web.RequestPayloadError)


_faults = logging.getLogger(f"{__name__}.http")
"""Log of the web server's errors; errors caused by what untrusted peers send are left out."""
_faults.addFilter(_is_ours)


class _Connection(web.RequestHandler):
    """Records when bytes arrive, before the task that reads them is woken."""

    received_ns = 0
    """Arrival of the last bytes, by the monotonic clock: possibly late, never early."""

    def data_received(self, data: bytes) -> None:
        self.received_ns = time.monotonic_ns()
        super().data_received(data)


class Door:
    """Accepts connections for a web server, and closes those that stay untrusted for too long."""

    def __init__(self) -> None:
        self._since_s: dict[asyncio.BaseTransport, float] = {}
        self._trusted: set[asyncio.BaseTransport] = set()
        self._greeting: dict[asyncio.Task[None], None] = {}
        """Connections that have not completed the TLS handshake, oldest first."""

    @contextlib.asynccontextmanager
    async def opened(
        self, server: web.Server, listening: socket.socket, tls: ssl.SSLContext | None
    ) -> AsyncIterator[None]:
        """Accept connections on a listening socket until the block ends."""
        tasks = [asyncio.create_task(self._accept(server, listening, tls))]
        tasks.append(asyncio.create_task(self._sweep(server)))
        try:
            yield
        finally:
            await end(*tasks, *self._greeting)
            listening.close()

    async def _accept(self, server: web.Server, listening: socket.socket, tls: ssl.SSLContext | None) -> None:
        listening.setblocking(False)
        while True:
            try:
                connection, _ = await asyncio.get_running_loop().sock_accept(listening)
            except OSError:
                await asyncio.sleep(LOOK_EVERY_S)  # for example if no file descriptor is left
                continue
            # TLS takes memory from the first moment, so the oldest silent connection yields to a new one.
            if len(self._greeting) >= MAX_GREETED:
                next(iter(self._greeting)).cancel()
            task = asyncio.create_task(self._greet(server, connection, tls))
            self._greeting[task] = None
            task.add_done_callback(lambda done: self._greeting.pop(done, None))

    async def _greet(self, server: web.Server, connection: socket.socket, tls: ssl.SSLContext | None) -> None:
        loop = asyncio.get_running_loop()
        try:
            await loop.connect_accepted_socket(
                lambda: _Connection(server, loop=loop, logger=_faults, keepalive_timeout=5.0),
                connection,
                ssl=tls,
                ssl_handshake_timeout=None if tls is None else HANDSHAKE_TIMEOUT_S,
            )
        except OSError:
            connection.close()
        except asyncio.CancelledError:
            connection.close()
            raise

    def trust(self, transport: asyncio.BaseTransport | None) -> None:
        """Keep a connection open: it belongs to an admitted phone."""
        if transport is not None:
            self._trusted.add(transport)

    async def _sweep(self, server: web.Server) -> None:
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            now_s = asyncio.get_running_loop().time()
            open_now = {one.transport for one in server.connections if one.transport is not None}
            self._trusted &= open_now
            known = self._since_s
            self._since_s = {one: known.get(one, now_s) for one in open_now - self._trusted}
            oldest_first = sorted(self._since_s, key=self._since_s.__getitem__)
            late = [one for one in oldest_first if now_s - self._since_s[one] >= IDENTIFY_TIMEOUT_S]
            for transport in (*late, *oldest_first[MAX_UNKNOWN:]):
                if isinstance(transport, asyncio.WriteTransport):
                    transport.abort()


PAGE = Path(__file__).parent / "page"


@dataclass(eq=False)
class _Link:
    """A page's link, the task that reads it, and the code and reason of its closing."""

    reading: asyncio.Task[None] = field(init=False)
    close_code: int = 0
    close_reason: bytes = b""

    def end(self, code: int, reason: bytes) -> None:
        """Close the link, with a code and a reason for the page."""
        # The reading task closes the link: when another does, aiohttp does not wait for the page's answer. A
        # page that is still sending then has its connection reset and loses the code. Without the code it
        # does not know that it is replaced, so it reconnects and takes the link from the newer page.
        self.close_code, self.close_reason = code, reason
        self.reading.cancel()


class PhoneGateway:
    """Serves the page and its links; `on_phone` decides how a phone's frames are used."""

    def __init__(
        self,
        admission: Admission,
        on_phone: Callable[[Phone], None],
        size: tuple[int, int] = DEFAULT_SIZE,
    ) -> None:
        """Create the gateway; `on_phone` is called once for each phone, when its page first connects.

        `size` is the width and height in pixels that phones are asked for.
        """
        self._admission = admission
        self._on_phone = on_phone
        self._size = size
        self._phones: dict[str, Phone] = {}
        self._door = Door()
        self._links: set[_Link] = set()
        self._link_of: dict[str, _Link] = {}
        """Current link of each phone, by its key."""

    @contextlib.asynccontextmanager
    async def serving(self, listening: socket.socket, tls: ssl.SSLContext | None) -> AsyncIterator[None]:
        """Serve on a listening socket until the block ends; then notify all pages."""
        app = web.Application(middlewares=[_guard], client_max_size=4096)
        app.on_response_prepare.append(_say_no_server)
        for part in PARTS:
            app.router.add_get(f"/{part}", self._send_part)
        app.router.add_post("/join", self._join)
        app.router.add_get("/link/{ticket}", self._link)
        runner = web.AppRunner(app)
        await runner.setup()
        assert runner.server is not None
        try:
            async with self._door.opened(runner.server, listening, tls):
                try:
                    yield
                finally:
                    for link in self._links:
                        link.end(1001, b"The leader has ended. This page waits for it.")
        finally:
            await runner.cleanup()

    async def _send_part(self, request: web.Request) -> web.Response:
        name, kind = PARTS[request.path.lstrip("/")]
        text = await asyncio.to_thread((PAGE / name).read_text, "utf-8")
        return web.Response(text=text.replace("@size@", "{}x{}".format(*self._size)), content_type=kind)

    async def _join(self, request: web.Request) -> web.Response:
        try:
            asked = msgspec.json.decode(await request.read(), type=dict[str, str])
            requested = asked["secret"], asked["key"], asked.get("name", "")
        except (*UNREADABLE, ValueError, KeyError, web.RequestPayloadError):
            words = "This page is outdated: load it again."
            return web.json_response({"words": words}, status=HTTPStatus.BAD_REQUEST)
        try:
            admitted = self._admission.admit(*requested)
        except UnknownMachineError as error:
            return web.json_response({"words": str(error)}, status=HTTPStatus.FORBIDDEN)
        return web.json_response({"name": admitted.name, "ticket": self._admission.ticket(admitted)})

    async def _link(self, request: web.Request) -> web.StreamResponse:
        admitted = self._admission.redeem(request.match_info["ticket"])
        if admitted is None:
            raise web.HTTPForbidden(text="this link was not asked for")
        socket_ = web.WebSocketResponse(
            timeout=CLOSE_S, compress=False, max_msg_size=wire.MAX_PICTURE_BYTES, heartbeat=HEARTBEAT_S
        )
        await socket_.prepare(request)
        link = _Link()
        link.reading = asyncio.create_task(self._read(link, socket_, admitted, request.protocol))
        self._links.add(link)
        try:
            await link.reading
        except asyncio.CancelledError:
            if not link.close_code:
                raise
        except (*UNREADABLE, ValueError, TimeoutError):
            link.end(1003, b"This page is of another version: load it again.")
        finally:
            self._links.discard(link)
        if link.close_code:
            await socket_.close(code=link.close_code, message=link.close_reason)
        return socket_

    async def _read(
        self,
        link: _Link,
        socket_: web.WebSocketResponse,
        admitted: Admitted,
        connection: web.RequestHandler,
    ) -> None:
        assert isinstance(connection, _Connection)
        hello = await _hello(socket_)
        self._door.trust(connection.transport)
        # Two pages would report two different clocks.
        self._end_link(admitted, _REPLACED)
        self._link_of[admitted.key] = link

        async def send(message: str | bytes) -> None:
            # The reading task notices a link that has just broken.
            with contextlib.suppress(ConnectionError):
                if not socket_.closed:
                    await (
                        socket_.send_str(message) if isinstance(message, str) else socket_.send_bytes(message)
                    )

        phone = self._phones.get(admitted.key)
        is_new = phone is None
        if phone is None:
            phone = self._phones[admitted.key] = Phone(admitted.name, time.monotonic_ns, hello)
            phone.put_off = functools.partial(self._put_off, admitted)
        phone.link_opened(send, hello)
        if is_new:
            self._on_phone(phone)
        try:
            async for message in socket_:
                received_ns = connection.received_ns
                if message.type is WSMsgType.BINARY:
                    report = wire.decode_binary(message.data)
                    if isinstance(report, wire.Ping):
                        phone.clock.note_pong(report, received_ns, time.monotonic_ns())
                        await send(wire.pong(report.number))
                    phone.take_binary(report, received_ns)
                elif message.type is WSMsgType.TEXT:
                    said = wire.decode_text(message.data)
                    if isinstance(said, wire.Hello):
                        raise ValueError("a second hello")
                    phone.take_text(said)
        finally:
            phone.link_closed(send, by_user=socket_.close_code == LEFT)

    def _put_off(self, admitted: Admitted) -> None:
        self._admission.put_off(admitted)
        if (phone := self._phones.pop(admitted.key, None)) is not None:
            phone.said_goodbye = True
        self._end_link(admitted, _PUT_OFF)

    def _end_link(self, admitted: Admitted, reason: bytes) -> None:
        if (link := self._link_of.get(admitted.key)) is not None:
            link.end(REPLACED, reason)


async def _hello(link: web.WebSocketResponse) -> wire.Hello:
    first = await link.receive(timeout=HELLO_S)
    hello = wire.decode_text(first.data) if first.type is WSMsgType.TEXT else None
    if not isinstance(hello, wire.Hello):
        raise ValueError("a page must begin with its hello")
    return hello


@web.middleware
async def _guard(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Refuse requests from other origins; add headers for precise timers and isolation to responses."""
    origin = request.headers.get("Origin")
    if origin is not None and origin.rpartition("://")[2] != request.host:
        raise web.HTTPForbidden(text="this address is for the phones' own page only")
    response = await handler(request)
    if not response.prepared:
        response.headers.update(_HEADERS)
        # Older browsers do not count a WebSocket to the page's own host as 'self'.
        response.headers["Content-Security-Policy"] = f"{_POLICY}; connect-src 'self' wss://{request.host}"
    return response


async def _say_no_server(request: web.Request, response: web.StreamResponse) -> None:
    """Remove the header that names the server program and its version."""
    response.headers.popall("Server", None)
