"""A web server that serves one page, to this machine or to phones of the network."""

import socket
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from capture_app.errors import NetworkError

DEFAULT_PORT = 8010
REQUEST_S = 10.0
"""A client that has not sent its request by then is let go."""


class PageServer(ThreadingHTTPServer):
    """Serves one page at `/`, and nothing else; `serve_forever` until `shutdown`."""

    daemon_threads = True

    def __init__(self, host: str, port: int, page: bytes, headers: Mapping[str, str]) -> None:
        """Listen; port 0 takes any that is free. Raises NetworkError."""
        self.page = page
        self.headers = dict(headers)
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            super().__init__((host, port), _PageHandler)
        except (OSError, UnicodeError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            where = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
            raise NetworkError(
                f"cannot listen on {where}: {reason}",
                hint="choose another with --host and --port; --port 0 takes a free one",
            ) from error

    def server_bind(self) -> None:
        """Bind without asking the name service for this machine's name, which may take long."""
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = str(self.server_address[0]), int(self.server_address[1])

    def handle_error(self, request: object, client_address: object) -> None:
        """A client that leaves in the middle is no error of ours."""


class _PageHandler(BaseHTTPRequestHandler):
    server: PageServer
    timeout = REQUEST_S
    server_version = "simulshot"
    sys_version = ""

    def do_GET(self) -> None:
        """Send the page."""
        self._answer(with_body=True)

    def do_HEAD(self) -> None:
        """Send what a GET would, without the page."""
        self._answer(with_body=False)

    def _answer(self, *, with_body: bool) -> None:
        if self.path.partition("?")[0] != "/":
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(self.server.page)))
        for name, value in self.server.headers.items():
            self.send_header(name, value)
        self.end_headers()
        if with_body:
            self.wfile.write(self.server.page)

    def log_message(self, format: str, *args: object) -> None:
        """Requests are not worth a line on stderr."""
