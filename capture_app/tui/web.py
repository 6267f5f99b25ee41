"""Terminal UI in a browser: a local web server that runs one screen for each open page."""

import asyncio
import shlex
import socket
import sys
from urllib.parse import urlsplit

from aiohttp import web
from aiohttp.typedefs import Handler
from textual_serve.server import Server

from capture_app.common.address import ANY_HOST, LOOPBACK_HOSTS, Address, reachable_host
from capture_app.rig.process import AttachedRig


class PageServer(Server):
    """Server of one rig's screen; rejects requests from pages of other sites."""

    def __init__(self, rig: AttachedRig, listening: socket.socket) -> None:
        host, port = listening.getsockname()[:2]
        self._names = (
            () if host not in LOOPBACK_HOSTS else tuple(str(Address(name, port)) for name in LOOPBACK_HOSTS)
        )
        """Host names accepted in requests; empty for any."""
        shown = reachable_host(host, listening.family) if host in ANY_HOST else host
        super().__init__(
            shlex.join((sys.executable, "-m", "capture_app.cli", *rig.screen_arguments)),
            host=host,
            port=port,
            title="simulshot",
            public_url=f"http://{Address(shown, port)}",
        )
        self._listening = listening

    async def run(self) -> None:
        """Serve until cancelled."""
        app = await self._make_app()
        app.on_startup.clear()
        app.middlewares.append(self._refuse_foreign_origins)
        runner = web.AppRunner(app)
        await runner.setup()
        try:
            await web.SockSite(runner, self._listening).start()
            await asyncio.Event().wait()
        finally:
            await runner.cleanup()

    @web.middleware
    async def _refuse_foreign_origins(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Reject other origins and host names: any page in the user's browser can send requests here."""
        origin = request.headers.get("Origin")
        if (origin is not None and urlsplit(origin).netloc != request.host) or (
            self._names and request.host not in self._names
        ):
            raise web.HTTPForbidden(text="the screen is for its own page only")
        return await handler(request)
