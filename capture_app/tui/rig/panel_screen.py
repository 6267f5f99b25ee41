"""How to check a rig with a panel: its page, served while one looks here, and what to do then."""

import asyncio
import textwrap
import threading
from contextlib import suppress
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.content import Content
from textual.screen import ModalScreen

from capture_app.errors import NetworkError, SimulshotError
from capture_app.net.address import Address, reachable_host
from capture_app.panel.screen import DEFAULT_PORT, PageServer, page_headers, page_html
from capture_app.text import printable
from capture_app.tui.question import Dialog
from capture_app.tui.rig.joining import qr_lines
from capture_app.tui.widgets.lines import Lines

ALL = "0.0.0.0"  # noqa: S104 - a phone is another machine
WIDTH = 40
"""Of the words, in cells; the code is beside them."""
_LIMITS = (
    "The page goes on when this is closed. A screen tells time to a part of its refresh (16.7 ms at 60 Hz); "
    "for microseconds build the panel of LEDs:"
)


class PanelScreen(Dialog[None], ModalScreen[None]):
    """Serves the panel's page to this machine and the network until it is closed; the page itself goes on."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "close", "Close", id="panel.close", key_display="esc"),
    ]
    DEFAULT_CSS = """
    PanelScreen { align: center middle; background: $background 60%; }
    PanelScreen > Vertical {
        width: 78; max-width: 100%; height: auto; max-height: 100%; padding: 0 1;
        background: $panel; border: round $primary; border-subtitle-color: $text-muted;
    }
    PanelScreen Horizontal { height: auto; }
    PanelScreen #panel-words { width: 1fr; height: auto; }
    PanelScreen #panel-code { width: auto; height: auto; }
    """

    def __init__(self) -> None:
        super().__init__()
        self._words, self._code = Lines(id="panel-words"), Lines(id="panel-code")
        self._server: PageServer | None = None
        self.url = ""

    def compose(self) -> ComposeResult:
        """The steps, and the code beside them."""
        box = Vertical(Horizontal(self._words, self._code))
        box.border_title = Content("Check the rig with a panel")
        box.border_subtitle = Content("esc closes")
        yield box

    async def on_mount(self) -> None:
        """Serve the page."""
        problem = ""
        try:
            self._server = await asyncio.to_thread(_listen)
        except SimulshotError as error:
            problem = str(error)
        else:
            host = reachable_host(ALL, self._server.socket.family)
            self.url = f"http://{Address(host, self._server.server_port)}/"
            threading.Thread(target=self._server.serve_forever, daemon=True).start()
            self._code.show(qr_lines(self.url))
        self._words.show(_steps(self.url, problem))

    async def on_unmount(self) -> None:
        """Stop serving."""
        if self._server is not None:
            await asyncio.to_thread(self._server.shutdown)
            self._server.server_close()

    def action_close(self) -> None:
        """Close it."""
        self.dismiss(None)


def _listen() -> PageServer:
    page, headers = page_html(), page_headers()
    with suppress(NetworkError):
        return PageServer(ALL, DEFAULT_PORT, page, headers)
    return PageServer(ALL, 0, page, headers)


def _steps(url: str, problem: str) -> list[Content]:
    """What to do, a line of WIDTH each."""
    where = (
        "Open this on ONE screen that all cameras see, and go full screen; on a phone by the code:"
        if url
        else f"{printable(problem)}. Type in a terminal: capture-app panel show"
    )
    paragraphs = (
        (f"1  {where}", ""),
        (f"   {url}", "bold $secondary"),
        ("2  Take a burst of it: 2, then Space.", ""),
        ("3  Read it: 3, then a, and choose Panel.", ""),
        ("", ""),
        (_LIMITS, "$foreground-muted"),
        ("capture-app panel sketch --out panel", "$foreground-muted"),
    )
    return [
        Content.styled(line, style)
        for text, style in paragraphs
        for line in textwrap.wrap(text, WIDTH, subsequent_indent="   " if text[:1].isdigit() else "") or [""]
    ]
