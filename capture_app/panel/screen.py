"""The page that draws the panel of a screen, whatever its refresh rate, and a server for it alone."""

import base64
import hashlib
import socket
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import msgspec

from capture_app.errors import NetworkError
from capture_app.panel.pattern import (
    PANELS,
    RATE_TOLERANCE,
    RATES_HZ,
    SCAN_SHARE,
    Panel,
    marker_squares,
    screen_panel,
)

HERE = Path(__file__).parent / "page"
SCRIPTS = ("counter.js", "drawing.js", "page.js")


def page_html() -> bytes:
    """Return the whole page; its policy allows its own script and style and nothing else."""
    script = '"use strict";\n' + "".join((HERE / name).read_text("utf-8") for name in SCRIPTS)
    style = (HERE / "page.css").read_text("utf-8")
    parts = {
        "policy": _policy(script, style),
        "style": style,
        "script": script,
        # What ends a script element must not stand in its text.
        "panels": msgspec.json.encode(_panels()).decode().replace("<", "\\u003c"),
    }
    page = (HERE / "page.html").read_text("utf-8")
    for name, text in parts.items():
        page = page.replace(f"@{name}@", text)
    return page.encode()


def page_headers() -> dict[str, str]:
    """Return the headers that a page cannot give itself."""
    return {
        "Content-Security-Policy": "frame-ancestors 'none'",
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cache-Control": "no-store",
    }


def _policy(script: str, style: str) -> str:
    def digest(text: str) -> str:
        return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"

    allowed = f"script-src {digest(script)}; style-src {digest(style)}; img-src data:"
    return f"default-src 'none'; {allowed}; base-uri 'none'; form-action 'none'"


def _panels() -> dict[str, Any]:
    """The layout that all panels of screens share, and what differs between them."""
    layout = screen_panel(RATES_HZ[0]).description()
    layout["markers"] = [{"x": marker["x"], "y": marker["y"]} for marker in layout["markers"]]
    kept = ("width", "height", "cycle_ticks", "marker_size", "markers", "dark", "lamp_size", "lamps")
    return {
        "scan_share": SCAN_SHARE,
        "layout": {key: layout[key] for key in kept} | {"rate_tolerance": RATE_TOLERANCE},
        "screens": [_screen(panel) for panel in PANELS.values() if panel.is_screen],
    }


def _screen(panel: Panel) -> dict[str, Any]:
    markers = [marker_squares(marker.number) for marker in panel.markers]
    return {
        "name": panel.name,
        "rate_hz": round(1e9 / panel.tick_ns),
        "scan": panel.scan.value,
        "markers": ["".join(str(white) for row in squares for white in row) for squares in markers],
    }


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
