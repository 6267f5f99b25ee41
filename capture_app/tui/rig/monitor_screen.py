"""QR code of the director's monitor, which is served until the screen ends."""

import asyncio
import time
from typing import TYPE_CHECKING

from textual.app import App

from capture_app.common.errors import SimulshotError
from capture_app.monitor import DEFAULT_PORT
from capture_app.rig.rig_link import RigLink
from capture_app.tui.rig.join_screen import LOOK_EVERY_S, GuideScreen, show_steps

if TYPE_CHECKING:
    from capture_app.web.listening import ListeningPage

ALL = "0.0.0.0"  # noqa: S104 - a phone is another machine
_STEPS = (
    "1  Scan the code with a phone or tablet, and open the page.",
    "2  The browser warns once that it does not know this machine: choose Advanced, then continue.",
    "3  It shows all cameras, and takes. It works until this screen ends.",
)


class MonitorServer:
    """Server of the monitors of this screen's rig, started when its code is first shown."""

    def __init__(self, source: RigLink, *, local: bool) -> None:
        self._source, self._local = source, local
        self._page: ListeningPage | None = None

    def guide(self) -> GuideScreen:
        """Return the dialog with the QR code for the next monitor; each monitor that joins renews it."""
        return GuideScreen("monitor", "A monitor in your hand", 36, self._show_codes)

    async def _show_codes(self, screen: GuideScreen) -> None:
        try:
            page = self._page or self._start(screen.app)
        except SimulshotError as error:
            screen.show("", (str(error), "$warning"))
            return
        shown = ""
        while True:
            invited = await page.invitation()
            if invited.url != shown:
                show_steps(screen, invited, _STEPS, came=bool(shown))
                shown = invited.url
            await asyncio.sleep(LOOK_EVERY_S)

    def _start(self, app: App[object]) -> "ListeningPage":
        from capture_app.web.admission import Admission
        from capture_app.web.listening import ListeningPage

        self._page = page = ListeningPage(Admission(time.monotonic, "monitor"), ALL, None, DEFAULT_PORT)
        app.run_worker(self._serve(page), group="monitor", exit_on_error=False)
        return page

    async def _serve(self, page: "ListeningPage") -> None:
        from capture_app.monitor.monitor_page import serving_monitor  # heavy: a web server

        async with serving_monitor(self._source.another(), page, is_local=self._local):
            await asyncio.Event().wait()
