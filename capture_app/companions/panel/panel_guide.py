"""Dialog of the terminal UI that serves the panel's page and shows how to check a rig with it."""

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import AsyncExitStack

from capture_app.common.address import ANY_HOST, Address, listen_tcp, reachable_host
from capture_app.common.errors import SimulshotError
from capture_app.companions.panel.screen import DEFAULT_PORT, page_html
from capture_app.rig.rig_link import RigLink
from capture_app.tui.rig.guide_screens import GuideScreen


class PanelGuide:
    """Guide to the panel: see `Guide`."""

    TITLE = "Check the rig with a panel"
    WIDTH = 40

    def __init__(
        self, source: RigLink, *, is_local: bool, run: Callable[[Coroutine[None, None, None]], object]
    ) -> None:
        """A panel needs no rig."""

    async def show(self, screen: GuideScreen) -> None:
        """Serve the panel's page, and show how to use it; a loaded page keeps running after the dialog."""
        from capture_app.web.own_page import served_page  # heavy: a web server

        where = "Open this page full-screen on ONE screen that all cameras see; a phone scans the code:"
        url = ""
        async with AsyncExitStack() as serving:
            try:
                listening = serving.enter_context(listen_tcp(ANY_HOST[1], DEFAULT_PORT, 0))
            except SimulshotError as error:
                where = f"{error}. Type in a terminal: capture-app panel show"
            else:
                await serving.enter_async_context(served_page(listening, await asyncio.to_thread(page_html)))
                port = listening.getsockname()[1]
                url = f"http://{Address(reachable_host(ANY_HOST[1], listening.family), port)}/"
            screen.show(
                url,
                (f"1  {where}", ""),
                (f"   {url}", "bold $secondary"),
                ("2  Take a burst of it: key 2, then Space.", ""),
                ("3  Read it: key 3, then a, and choose Panel.", ""),
                ("", ""),
                (
                    "An open page keeps running when this is closed. A screen resolves part of its refresh "
                    "interval (16.7 ms at 60 Hz). For microseconds build the LED panel:",
                    "$foreground-muted",
                ),
                ("capture-app panel sketch --out panel", "$foreground-muted"),
            )
            await asyncio.Event().wait()
