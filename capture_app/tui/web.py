"""The screen in a browser: a web server of this machine that runs one screen for each page that is open."""

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
    """Serves the screen of one rig; to other sites' pages it does not answer, whatever browser asks."""

    def __init__(self, rig: AttachedRig, listening: socket.socket) -> None:
        host, port = listening.getsockname()[:2]
        self._names = (
            () if host not in LOOPBACK_HOSTS else tuple(str(Address(name, port)) for name in LOOPBACK_HOSTS)
        )
        """The hosts by which the page may be asked for; empty for any."""
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
        app.middlewares.append(self._refuse_strangers)
        runner = web.AppRunner(app)
        await runner.setup()
        try:
            await web.SockSite(runner, self._listening).start()
            await asyncio.Event().wait()
        finally:
            await runner.cleanup()

    @web.middleware
    async def _refuse_strangers(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Any page in the user's browser can ask this server, or call it by a name of its own."""
        origin = request.headers.get("Origin")
        if (origin is not None and urlsplit(origin).netloc != request.host) or (
            self._names and request.host not in self._names
        ):
            raise web.HTTPForbidden(text="the screen is for its own page only")
        return await handler(request)
