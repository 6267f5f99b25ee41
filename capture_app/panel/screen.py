"""Web page that draws a screen panel at any refresh rate, and a server for that page alone."""

import asyncio
import base64
import contextlib
import hashlib
import logging
import socket
from collections.abc import AsyncIterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from capture_app.common.address import is_own_page
from capture_app.panel.pattern import (
    PANELS,
    RATE_TOLERANCE,
    SCAN_FRACTION,
    marker_squares,
)

if TYPE_CHECKING:
    from aiohttp import web

HERE = Path(__file__).parent / "page"
SCRIPTS = ("counter.js", "drawing.js", "page.js")
DEFAULT_PORT = 8010
HEADERS = {
    "Content-Security-Policy": "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
"""Security headers that a page cannot set in its own markup."""
_faults = logging.getLogger(f"{__name__}.http")
_faults.disabled = True
"""Malformed requests of unknown clients are not logged."""


def page_html() -> bytes:
    """Return the complete page; its content security policy allows only its own script and style."""
    script = '"use strict";\n' + "".join((HERE / name).read_text("utf-8") for name in SCRIPTS)
    style = (HERE / "page.css").read_text("utf-8")
    parts = {
        "policy": _policy(script, style),
        "style": style,
        "script": script,
        # A closing script tag must not appear in the script's text.
        "panels": msgspec.json.encode(_panels()).decode().replace("<", "\\u003c"),
    }
    page = (HERE / "page.html").read_text("utf-8")
    for name, text in parts.items():
        page = page.replace(f"@{name}@", text)
    return page.encode()


def _policy(script: str, style: str) -> str:
    digests = (hashlib.sha256(text.encode()).digest() for text in (script, style))
    allowed = "script-src 'sha256-{}'; style-src 'sha256-{}'; img-src data:".format(
        *(base64.b64encode(digest).decode() for digest in digests)
    )
    return f"default-src 'none'; {allowed}; base-uri 'none'; form-action 'none'"


def _panels() -> dict[str, Any]:
    """Return the layout shared by all screen panels, and the values that differ between them."""
    screens = [panel for panel in PANELS.values() if panel.is_screen]
    layout = screens[0].description()
    layout["markers"] = [{"x": marker["x"], "y": marker["y"]} for marker in layout["markers"]]
    fields = ("width", "height", "cycle_ticks", "marker_size", "markers", "dark", "lamp_size", "lamps")
    return {
        "scan_share": SCAN_FRACTION,
        "layout": {key: layout[key] for key in fields} | {"rate_tolerance": RATE_TOLERANCE},
        "screens": [
            {
                "name": panel.name,
                "rate_hz": round(1e9 / panel.tick_ns),
                "scan": panel.scan,
                "markers": [
                    "".join(str(white) for row in marker_squares(marker.number) for white in row)
                    for marker in panel.markers
                ],
            }
            for panel in screens
        ],
    }


@contextlib.asynccontextmanager
async def served_page(listening: socket.socket) -> AsyncIterator[None]:
    """Serve the page at `/`, and nothing else, on a listening socket while the block runs."""
    from aiohttp import web

    page = await asyncio.to_thread(page_html)

    async def send(request: "web.Request") -> "web.Response":
        if not is_own_page(request.host, request.headers.get("Origin")):
            raise web.HTTPForbidden(text="Open the page by this machine's address or host name.\n")
        return web.Response(body=page, headers=HEADERS, content_type="text/html", charset="utf-8")

    app = web.Application()
    app.router.add_get("/", send)
    runner = web.AppRunner(app, access_log=None, logger=_faults)
    await runner.setup()
    try:
        await web.SockSite(runner, listening).start()
        yield
    finally:
        await runner.cleanup()
