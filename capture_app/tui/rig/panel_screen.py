"""How to check a rig with a panel: its page, served while one looks here, and what to do then."""

from contextlib import AsyncExitStack

from capture_app.errors import SimulshotError
from capture_app.net.address import Address, listen_tcp, reachable_host
from capture_app.panel.screen import DEFAULT_PORT, served_page
from capture_app.tui.rig.joining import GuideScreen

ALL = "0.0.0.0"  # noqa: S104 - a phone is another machine
_LIMITS = (
    "The page goes on when this is closed. A screen tells time to a part of its refresh (16.7 ms at 60 Hz); "
    "for microseconds build the panel of LEDs:"
)


class PanelScreen(GuideScreen):
    """Serves the panel's page to this machine and the network until it is closed; the page itself goes on."""

    def __init__(self) -> None:
        super().__init__("panel", "Check the rig with a panel", 40)
        self._serving = AsyncExitStack()
        self.url = ""

    async def on_mount(self) -> None:
        """Serve the page."""
        where = "Open this on ONE screen that all cameras see, and go full screen; on a phone by the code:"
        try:
            listening = self._serving.enter_context(listen_tcp(ALL, DEFAULT_PORT, 0))
        except SimulshotError as error:
            where = f"{error}. Type in a terminal: capture-app panel show"
        else:
            await self._serving.enter_async_context(served_page(listening))
            self.url = f"http://{Address(reachable_host(ALL, listening.family), listening.getsockname()[1])}/"
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
        await self._serving.aclose()
