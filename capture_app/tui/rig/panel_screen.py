"""Instructions for checking a rig with a panel, whose page is served while the dialog is open."""

import asyncio
from contextlib import AsyncExitStack

from capture_app.common.address import Address, listen_tcp, reachable_host
from capture_app.common.errors import SimulshotError
from capture_app.panel.screen import DEFAULT_PORT, served_page
from capture_app.tui.rig.join_screen import GuideScreen

ALL = "0.0.0.0"  # noqa: S104 - a phone is another machine
_LIMITS = (
    "An open page keeps running when this is closed. A screen resolves part of its refresh interval "
    "(16.7 ms at 60 Hz). For microseconds build the LED panel:"
)


def panel_screen() -> GuideScreen:
    """Return the dialog; it serves the panel's page while open, and a loaded page keeps running."""
    return GuideScreen("panel", "Check the rig with a panel", 40, _serve)


async def _serve(screen: GuideScreen) -> None:
    where = "Open this page full-screen on ONE screen that all cameras see; a phone scans the code:"
    url = ""
    async with AsyncExitStack() as serving:
        try:
            listening = serving.enter_context(listen_tcp(ALL, DEFAULT_PORT, 0))
        except SimulshotError as error:
            where = f"{error}. Type in a terminal: capture-app panel show"
        else:
            await serving.enter_async_context(served_page(listening))
            url = f"http://{Address(reachable_host(ALL, listening.family), listening.getsockname()[1])}/"
        screen.show(
            url,
            (f"1  {where}", ""),
            (f"   {url}", "bold $secondary"),
            ("2  Take a burst of it: key 2, then Space.", ""),
            ("3  Read it: key 3, then a, and choose Panel.", ""),
            ("", ""),
            (_LIMITS, "$foreground-muted"),
            ("capture-app panel sketch --out panel", "$foreground-muted"),
        )
        await asyncio.Event().wait()
