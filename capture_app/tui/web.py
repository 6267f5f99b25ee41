"""Terminal UI in a browser: a local web server that runs one screen for each open page."""

import asyncio
import shlex
import socket
import sys
from collections.abc import Collection

from aiohttp import web
from aiohttp.typedefs import Handler
from textual_serve.server import Server

from capture_app.common.address import Address, is_own_page, reachable_host
from capture_app.rig.process import AttachedRig


class PageServer(Server):
    """Server of one rig's screen; rejects requests from pages of other sites."""

    def __init__(self, rig: AttachedRig, listening: socket.socket, names: Collection[str] = ()) -> None:
        """Create the server; browsers may address this machine by its own names or by one of `names`."""
        host, port = listening.getsockname()[:2]
        self._names = names
        super().__init__(
            shlex.join((sys.executable, "-m", "capture_app.cli", *rig.screen_arguments)),
            host=host,
            port=port,
            title="simulshot",
            public_url=f"http://{Address(reachable_host(host, listening.family), port)}",
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
        if not is_own_page(request.host, request.headers.get("Origin"), self._names):
            raise web.HTTPForbidden(
                text="The screen is for its own page only: open it by this machine's address or host name, "
                "or start it with capture-app serve --allow-host NAME.\n"
            )
        return await handler(request)
