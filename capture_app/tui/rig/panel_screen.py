"""How to check a rig with a panel: its page, served while one looks here, and what to do then."""

import asyncio
import threading
from contextlib import suppress
from typing import ClassVar

from textual.binding import Binding, BindingType

from capture_app.errors import NetworkError, SimulshotError
from capture_app.net.address import Address, reachable_host
from capture_app.panel.screen import DEFAULT_PORT, PageServer, page_headers, page_html
from capture_app.tui.rig.joining import GuideScreen

ALL = "0.0.0.0"  # noqa: S104 - a phone is another machine
_LIMITS = (
    "The page goes on when this is closed. A screen tells time to a part of its refresh (16.7 ms at 60 Hz); "
    "for microseconds build the panel of LEDs:"
)


class PanelScreen(GuideScreen):
    """Serves the panel's page to this machine and the network until it is closed; the page itself goes on."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "dismiss", "Close", id="panel.close", key_display="esc"),
    ]

    def __init__(self) -> None:
        super().__init__("panel", "Check the rig with a panel", 40)
        self._server: PageServer | None = None
        self.url = ""

    async def on_mount(self) -> None:
        """Serve the page."""
        where = "Open this on ONE screen that all cameras see, and go full screen; on a phone by the code:"
        try:
            self._server = await asyncio.to_thread(_listen)
        except SimulshotError as error:
            where = f"{error}. Type in a terminal: capture-app panel show"
        else:
            host = reachable_host(ALL, self._server.socket.family)
            self.url = f"http://{Address(host, self._server.server_port)}/"
            threading.Thread(target=self._server.serve_forever, daemon=True).start()
        self.show(
            self.url,
            (f"1  {where}", ""),
            (f"   {self.url}", "bold $secondary"),
            ("2  Take a burst of it: 2, then Space.", ""),
            ("3  Read it: 3, then a, and choose Panel.", ""),
            ("", ""),
            (_LIMITS, "$foreground-muted"),
            ("capture-app panel sketch --out panel", "$foreground-muted"),
        )

    async def on_unmount(self) -> None:
        """Stop serving."""
        if self._server is not None:
            await asyncio.to_thread(self._server.shutdown)
            self._server.server_close()


def _listen() -> PageServer:
    page, headers = page_html(), page_headers()
    with suppress(NetworkError):
        return PageServer(ALL, DEFAULT_PORT, page, headers)
    return PageServer(ALL, 0, page, headers)
