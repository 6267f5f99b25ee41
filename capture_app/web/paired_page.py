"""Web server of a page whose devices are admitted by a QR code: its address, files, and a link per device.

Connections that have not identified themselves get few resources, for a short time.
"""

import asyncio
import contextlib
import logging
import socket
import ssl
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Collection, Iterable, Mapping
from datetime import UTC, datetime
from http import HTTPStatus
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType

import msgspec
from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError
from aiohttp.typedefs import Handler
from platformdirs import user_data_path

from capture_app.common.address import Address, listen_tcp, reachable_host
from capture_app.common.errors import UnknownMachineError
from capture_app.common.host_clock import host_ns
from capture_app.common.tasks import end
from capture_app.common.text import UNREADABLE, fill_in
from capture_app.common.timeouts import HANDSHAKE_TIMEOUT_S, IDENTIFY_TIMEOUT_S
from capture_app.protocol.orders import PhoneInvited
from capture_app.web.admission import Admission, Admitted
from capture_app.web.certificate import load_certificate, own_certificate
from capture_app.web.own_page import only_own_page

MAX_UNKNOWN = 128
"""Max number of open connections without an admitted device; the oldest in excess are closed."""
MAX_GREETED = 64
MAX_LINKS_PER_DEVICE = 8
"""Maximum number of links of an admitted device, one for each open page; the oldest in excess is closed."""
BAD_PAGE = 1003
"""Code that closes a link whose page must not connect again by itself."""
LOOK_EVERY_S = 0.5
HEARTBEAT_S = 5.0
CLOSE_S = 2.0
"""Timeout of a page's answer to the closing of its link."""
_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}
_POLICY = (
    "default-src 'none'; script-src 'self'; worker-src 'self'; style-src 'self'; img-src data: blob:;"
    " media-src 'self' blob: mediastream:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    # Browsers give precise timers only to a page that is isolated from other origins.
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Embedder-Policy": "require-corp",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(self), screen-wake-lock=(self), microphone=(self), geolocation=()",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


def _is_ours(record: logging.LogRecord) -> bool:
    _, error, _ = record.exc_info or (None, None, None)
    return not isinstance(error, HttpProcessingError | web.RequestPayloadError)


_faults = logging.getLogger(f"{__name__}.http")
"""Log of the web server's errors; errors caused by what untrusted peers send are left out."""
_faults.addFilter(_is_ours)


class _Connection(web.RequestHandler):
    """Records when bytes arrive, before the task that reads them is woken."""

    received_ns = 0
    """Arrival of the last bytes, in the host's clock: possibly late, never early."""

    def data_received(self, data: bytes) -> None:
        self.received_ns = host_ns()
        super().data_received(data)


class Door:
    """Accepts connections for a web server, and closes those that stay untrusted for too long."""

    def __init__(self) -> None:
        self._since_s: dict[asyncio.BaseTransport, float] = {}
        self.trusted: set[asyncio.BaseTransport | None] = set()
        """Connections of admitted devices, which stay open."""
        self._greeting: dict[asyncio.Task[None], None] = {}
        """Connections that have not completed the TLS handshake, oldest first."""

    @contextlib.asynccontextmanager
    async def opened(
        self, server: web.Server, listening: socket.socket, tls: ssl.SSLContext | None
    ) -> AsyncIterator[None]:
        """Accept connections on a listening socket until the block ends."""
        accepting = asyncio.create_task(self._accept(server, listening, tls))
        sweeping = asyncio.create_task(self._sweep(server))
        with listening:
            try:
                yield
            finally:
                await end(accepting, sweeping, *self._greeting)

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
                # It is closed before the next one is accepted.
                await end(next(iter(self._greeting)))
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
        self._close_unknown(server)

    async def _sweep(self, server: web.Server) -> None:
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            self._close_unknown(server)

    def _close_unknown(self, server: web.Server) -> None:
        """Close unknown connections that are open for too long, and the oldest where there are too many."""
        now_s = asyncio.get_running_loop().time()
        transports = (connection.transport for connection in server.connections)
        open_now = {
            transport for transport in transports if transport is not None and not transport.is_closing()
        }
        self.trusted &= open_now
        self._since_s = {
            connection: self._since_s.get(connection, now_s) for connection in open_now - self.trusted
        }
        newest_first = sorted(self._since_s.items(), key=itemgetter(1), reverse=True)
        for number, (transport, since_s) in enumerate(newest_first):
            is_late = now_s - since_s >= IDENTIFY_TIMEOUT_S
            if isinstance(transport, asyncio.WriteTransport) and (is_late or number >= MAX_UNKNOWN):
                transport.abort()


class PageLink:
    """WebSocket of an admitted device's page."""

    def __init__(self, admitted: Admitted, socket_: web.WebSocketResponse, connection: _Connection) -> None:
        self.admitted, self.socket, self.connection = admitted, socket_, connection
        self.reading: asyncio.Task[None]
        """Task that reads the link."""
        self.close_code, self.close_reason = 0, b""

    async def send(self, message: str | bytes) -> None:
        """Send a message; the reading task notices a link that has just broken."""
        with contextlib.suppress(ConnectionError):
            if not self.socket.closed:
                await (
                    self.socket.send_str(message)
                    if isinstance(message, str)
                    else self.socket.send_bytes(message)
                )

    def end(self, code: int, reason: bytes) -> None:
        """Close the link, with a code and a reason for the page."""
        # The reading task closes the link: when another does, aiohttp does not wait for the page's answer. A
        # page that is still sending then has its connection reset and loses the code. Without the code it
        # does not know that it is replaced, so it reconnects and takes the link from the newer page.
        self.close_code, self.close_reason = code, reason
        self.reading.cancel()


class PairedPage(ABC):
    """Server of a page's files, and of links to the devices that its admission knows."""

    max_message_bytes = 1 << 16

    def __init__(
        self,
        admission: Admission,
        folder: Path,
        values: Mapping[str, str] = MappingProxyType({}),
        shared: Iterable[Path] = (),
    ) -> None:
        """Create a server of a folder's files and of `shared` ones.

        `values` replace the placeholders @NAME@ in the files.
        """
        self.admission = admission
        self._files = {path.name.removeprefix("index.html"): path for path in (*folder.iterdir(), *shared)}
        self._values = values
        self._door = Door()
        self._links: dict[PageLink, None] = {}
        """Open links, oldest first."""

    def add_routes(self, app: web.Application) -> None:  # noqa: B027 - most pages have none
        """Add requests that devices may send beside their link; each checks that they are admitted."""

    @abstractmethod
    async def serve_link(self, link: PageLink) -> None:
        """Serve a device until its page closes the link.

        A ValueError or a TimeoutError tells the page that it is of another version.
        """

    @contextlib.asynccontextmanager
    async def serving(
        self, listening: socket.socket, tls: ssl.SSLContext | None, names: Collection[str] = ()
    ) -> AsyncIterator[None]:
        """Serve on a listening socket until the block ends; then notify all pages.

        Pages may call this machine by its own names and by `names`.
        """
        refusal = "This is for its own page only: open it by this machine's address."
        app = web.Application(middlewares=[_add_headers, only_own_page(names, refusal)], client_max_size=4096)
        app.on_response_prepare.append(_say_no_server)
        for name in self._files:
            app.router.add_get(f"/{name}", self._send_file)
        app.router.add_post("/join", self._join)
        app.router.add_get("/link/{ticket}", self._link)
        self.add_routes(app)
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

    async def _send_file(self, request: web.Request) -> web.Response:
        path = self._files[request.path.lstrip("/")]
        text = await asyncio.to_thread(path.read_text, "utf-8")
        return web.Response(text=fill_in(text, self._values), content_type=_TYPES[path.suffix])

    async def _join(self, request: web.Request) -> web.Response:
        try:
            asked = msgspec.json.decode(await request.read(), type=dict[str, str])
            requested = asked["secret"], asked["key"], asked.get("name", "")
        except (*UNREADABLE, ValueError, KeyError, web.RequestPayloadError):
            return web.json_response(
                {"words": "This page is outdated: load it again."}, status=HTTPStatus.BAD_REQUEST
            )
        try:
            admitted = self.admission.admit(*requested)
        except UnknownMachineError as error:
            return web.json_response({"words": str(error)}, status=HTTPStatus.FORBIDDEN)
        return web.json_response({"name": admitted.name, "ticket": self.admission.ticket(admitted)})

    async def _link(self, request: web.Request) -> web.StreamResponse:
        admitted = self.admission.redeem(request.match_info["ticket"])
        if admitted is None:
            raise web.HTTPForbidden(text="this link was not asked for")
        socket_ = web.WebSocketResponse(
            timeout=CLOSE_S, compress=False, max_msg_size=self.max_message_bytes, heartbeat=HEARTBEAT_S
        )
        await socket_.prepare(request)
        assert isinstance(request.protocol, _Connection)
        link = PageLink(admitted, socket_, request.protocol)
        link.reading = asyncio.create_task(self.serve_link(link))
        self._links[link] = None
        own = [link for link in self._links if link.admitted == admitted]
        for oldest in own[:-MAX_LINKS_PER_DEVICE]:
            oldest.end(BAD_PAGE, b"Too many pages of this device are open: close some.")
        self._door.trusted.add(request.transport)
        try:
            await link.reading
        except asyncio.CancelledError:
            if not link.close_code:
                raise
        except (*UNREADABLE, ValueError, TimeoutError):
            link.end(BAD_PAGE, b"This page is of another version: load it again.")
        finally:
            self._links.pop(link, None)
        if link.close_code:
            await socket_.close(code=link.close_code, message=link.close_reason)
        return socket_


@web.middleware
async def _add_headers(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Add headers for precise timers and isolation to responses."""
    response = await handler(request)
    if not response.prepared:
        # Older browsers do not count a WebSocket to the page's own host as 'self'.
        response.headers.update(
            _HEADERS, **{"Content-Security-Policy": f"{_POLICY}; connect-src 'self' wss://{request.host}"}
        )
    return response


async def _say_no_server(request: web.Request, response: web.StreamResponse) -> None:
    """Remove the header that names the server program and its version."""
    response.headers.popall("Server", None)


class ListeningPage:
    """Listening socket with the address and the certificate that devices see."""

    def __init__(
        self,
        admission: Admission,
        host: str,
        port: int | None,
        default_port: int,
        certificate: Path | None = None,
    ) -> None:
        """Listen on a port, 0 for any; None: the default one, or any if that is in use.

        `certificate` is a file of the user's; None: one that is created here and stored. Raises NetworkError,
        BadInputError for a file without a certificate, DiskError.
        """
        self.admission = admission
        self.socket = listen_tcp(host, *((default_port, 0) if port is None else (port,)))
        shown = reachable_host(host, self.socket.family)
        self.address = Address(shown, self.socket.getsockname()[1])
        folder = user_data_path("simulshot", appauthor=False) / "trust"
        self._certificate = (
            own_certificate(folder, (shown, socket.gethostname()), datetime.now(UTC))
            if certificate is None
            else load_certificate(certificate)
        )
        self.tls = self._certificate.server_context()
        self.names = (host, *self._certificate.names())
        """Names by which requests may call this machine, besides its own."""

    async def invitation(self) -> PhoneInvited:
        """Return the page for the next device."""
        # Read the secret first: it may be a new one, whose validity starts then.
        return PhoneInvited(
            url=f"https://{self.address}/#{self.admission.secret}",
            fingerprint=self._certificate.fingerprint,
            good_for_s=self.admission.good_for_s,
        )
