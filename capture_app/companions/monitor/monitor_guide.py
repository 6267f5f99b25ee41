"""Dialog of the terminal UI that shows how a phone or tablet becomes a monitor, and serves its page."""

import asyncio
from collections.abc import Callable, Coroutine
from functools import cached_property
from typing import TYPE_CHECKING

from capture_app.common import system
from capture_app.common.address import ANY_HOST
from capture_app.companions.monitor import DEFAULT_PORT
from capture_app.rig.rig_link import RigLink
from capture_app.tui.rig.guide_screens import BROWSER_STEP, GuideScreen, show_codes

if TYPE_CHECKING:
    from capture_app.web.paired_page import ListeningPage

STEPS = (
    "1  Scan the code with a phone or tablet, and open the page.",
    BROWSER_STEP,
    "3  See all cameras and take pictures there. The page works until simulshot quits.",
)


class MonitorGuide:
    """Guide to the monitor: see `Guide`."""

    TITLE = "A monitor in your hand"
    WIDTH = 36

    def __init__(
        self, source: RigLink, *, is_local: bool, run: Callable[[Coroutine[None, None, None]], object]
    ) -> None:
        """`run` serves the page for longer than the dialog is open."""
        self._source, self._is_local, self._run = source, is_local, run

    async def show(self, screen: GuideScreen) -> None:
        """Show the code for the next device."""
        await show_codes(lambda: self._page.invitation(), STEPS, screen)

    @cached_property
    def _page(self) -> "ListeningPage":
        """Page of the monitors of this rig, served since its code was first shown. Raises SimulshotError."""
        from capture_app.web.admission import Admission
        from capture_app.web.paired_page import ListeningPage

        page = ListeningPage(Admission(system.monotonic_s, "monitor"), ANY_HOST[1], None, DEFAULT_PORT)
        self._run(self._serve(page))
        return page

    async def _serve(self, page: "ListeningPage") -> None:
        from capture_app.companions.monitor.monitor_page import serving_monitor  # heavy: a web server

        async with serving_monitor(self._source.another(), page, is_local=self._is_local):
            await asyncio.Event().wait()
