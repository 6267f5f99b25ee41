"""Web servers of this machine's own pages: which requests they accept, and how they are served."""

import contextlib
import logging
import socket
from collections.abc import AsyncIterator, Collection
from typing import Any
from urllib.parse import urlsplit

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from capture_app.common.address import LOOPBACK_HOSTS, own_hosts

_HEADERS = {
    "Content-Security-Policy": "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
"""Security headers that a page cannot set in its own markup."""
_faults = logging.getLogger(f"{__name__}.http")
_faults.disabled = True
"""Malformed requests of unknown clients are not logged."""


def is_own_page(host: str, origin: str | None, names: Collection[str] = ()) -> bool:
    """Return whether a web request is for this machine and comes from its own page.

    `host` and `origin` are the request's headers. A page of another site can have its own name resolve to
    this machine (DNS rebinding), so only its addresses and host name, and `names`, are accepted.
    """
    try:
        name = (urlsplit(f"//{host}").hostname or "").lower()
        foreign = origin is not None and urlsplit(origin).netloc.lower() != host.lower()
    except ValueError:
        return False
    own = socket.gethostname().lower()
    accepted = {*LOOPBACK_HOSTS, own, f"{own.partition('.')[0]}.local", *map(str.lower, names)}
    addresses = (host for family in (socket.AF_INET, socket.AF_INET6) for host in own_hosts(family))
    return not foreign and (name in accepted or name in addresses)


def only_own_page(names: Collection[str], refusal: str) -> Middleware:
    """Return a middleware that rejects other origins and host names with a text for the browser.

    Any page in the user's browser can send requests here; `names` are further names of this machine.
    """

    @web.middleware
    async def check_origin(request: web.Request, handler: Handler) -> web.StreamResponse:
        if not is_own_page(request.host, request.headers.get("Origin"), names):
            raise web.HTTPForbidden(text=refusal)
        return await handler(request)

    return check_origin


@contextlib.asynccontextmanager
async def served(app: web.Application, listening: socket.socket, **options: Any) -> AsyncIterator[None]:
    """Serve an application on a listening socket while the block runs; `options` are aiohttp's for it."""
    runner = web.AppRunner(app, **options)
    await runner.setup()
    try:
        await web.SockSite(runner, listening).start()
        yield
    finally:
        await runner.cleanup()


@contextlib.asynccontextmanager
async def served_page(listening: socket.socket, page: bytes) -> AsyncIterator[None]:
    """Serve a page at `/`, and nothing else, on a listening socket while the block runs."""

    async def send(_: web.Request) -> web.Response:
        return web.Response(body=page, headers=_HEADERS, content_type="text/html", charset="utf-8")

    app = web.Application(
        middlewares=[only_own_page((), "Open the page by this machine's address or host name.\n")]
    )
    app.router.add_get("/", send)
    async with served(app, listening, access_log=None, logger=_faults):
        yield
