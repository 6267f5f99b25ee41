"""How machines and phones join: lines and QR codes.

How another machine joins: the line to type there, and the same as a QR code.

How phones become cameras: the page as a QR code, for one phone after the other.
"""

import asyncio
import textwrap
from typing import ClassVar

import segno
from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.content import Content
from textual.screen import ModalScreen

from capture_app.errors import SimulshotError
from capture_app.node.rig_link import RigLink
from capture_app.node.wire.operating import PhoneInvited
from capture_app.text import printable
from capture_app.trust.pairing import show_code
from capture_app.tui.question import Dialog
from capture_app.tui.widgets.lines import Lines

DEVICE = "v4l2:/dev/video0"
QUIET = 2
"""Modules of light around the code; readers of screens do with two."""
_HALF = {(True, True): "█", (True, False): "▀", (False, True): "▄", (False, False): " "}


NOT_INVITED = "A machine that is not known here yet asks for a number, once: press i."


async def invitation(source: RigLink) -> str:
    """Let the leader make a code for the next machine, and return what to say of it, or why there is none."""
    try:
        invited = await source.invite()
    except SimulshotError as error:
        return printable(str(error)).capitalize()
    return (
        f"A machine that is not known here yet asks for a number, once: {show_code(invited.code)}."
        f" It is for one machine and {invited.good_for_s // 60} minutes; i shows another."
    )


def joining_line(leader: str) -> str:
    """The command for the machine of a camera."""
    return f"capture-app node --leader {leader} --camera {DEVICE}"


def qr_lines(text: str) -> list[Content]:
    """A QR code in half blocks, light on dark: what is drawn are its light modules."""
    code = segno.make(text, error="l", boost_error=False, micro=False)
    light = [[not module for module in row] for row in code.matrix_iter(border=QUIET)]
    if len(light) % 2:
        light.append([False] * len(light[0]))
    return [
        Content.styled("".join(_HALF[pair] for pair in zip(upper, lower, strict=True)), "#ffffff on #000000")
        for upper, lower in zip(light[::2], light[1::2], strict=True)
    ]


WIDTH = 38
"""Of the words, in cells; the code is beside them."""
LOOK_EVERY_S = 1.0


class PhonesScreen(Dialog[None], ModalScreen[None]):
    """Shows the code of the next phone, another one when a phone has come; their server goes on."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "close", "Close", id="phones.close", key_display="esc"),
    ]
    DEFAULT_CSS = """
    PhonesScreen { align: center middle; background: $background 60%; }
    PhonesScreen > Vertical {
        width: 78; max-width: 100%; height: auto; max-height: 100%; padding: 0 1;
        background: $panel; border: round $primary; border-subtitle-color: $text-muted;
    }
    PhonesScreen Horizontal { height: auto; }
    PhonesScreen #phones-words { width: 1fr; height: auto; }
    PhonesScreen #phones-code { width: auto; height: auto; }
    """

    def __init__(self, source: RigLink) -> None:
        super().__init__()
        self._source = source
        self._words, self._code = Lines(id="phones-words"), Lines(id="phones-code")
        self._shown: PhoneInvited | None = None

    def compose(self) -> ComposeResult:
        """The steps, and the code beside them."""
        box = Vertical(Horizontal(self._words, self._code))
        box.border_title = Content("Phones as cameras")
        box.border_subtitle = Content("esc closes")
        yield box

    def on_mount(self) -> None:
        """Ask for the first code, and look whether it has been used."""
        self._words.show([Content("One moment: the page is being prepared …")])
        self._keep_looking()

    def action_close(self) -> None:
        """Close it."""
        self.dismiss(None)

    @work(exclusive=True, group="phones")
    async def _keep_looking(self) -> None:
        while True:
            try:
                self._show_invited(await self._source.invite_phone())
            except SimulshotError as error:
                self._shown = None
                self._code.show([])
                self._words.show(_wrapped(printable(str(error)), "$warning"))
            await asyncio.sleep(LOOK_EVERY_S)

    def _show_invited(self, invited: PhoneInvited) -> None:
        if self._shown is None or invited.url != self._shown.url:
            came = self._shown is not None
            self._shown = invited
            self._code.show(qr_lines(invited.url))
            self._words.show(_steps(invited, came=came))


def _steps(invited: PhoneInvited, *, came: bool) -> list[Content]:
    begin = "That code was used, or its time was over. For the next phone:" if came else ""
    paragraphs = (
        (begin, "$success"),
        ("1  Scan the code with the phone, and open the page.", ""),
        ("2  Its browser warns, once: it does not know this machine. Go on (Advanced).", ""),
        ("3  Start the camera, allow it; put the phone in its place, and plug it in.", ""),
        ("", ""),
        (printable(invited.url), "bold $secondary"),
        ("", ""),
        (
            "Each code is for one phone and ten minutes. If you doubt this network, compare the SHA-256 of"
            " the certificate in the phone's browser:",
            "$foreground-muted",
        ),
        (printable(invited.fingerprint), "$foreground-muted"),
    )
    return [line for text, style in paragraphs if text or not style for line in _wrapped(text, style)]


def _wrapped(text: str, style: str) -> list[Content]:
    indent = "   " if text[:1].isdigit() else ""
    lines = textwrap.wrap(text, WIDTH, subsequent_indent=indent) or [""]
    return [Content.styled(line, style) for line in lines]
