"""Dialogs with instructions and a QR code: for other machines and phones, and those of companions.

Companions' are entry points of the group `simulshot.guides`, each named like its action: classes as `Guide`.
"""

import asyncio
import textwrap
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import aclosing
from typing import ClassVar, Protocol

import segno
from textual.binding import Binding, BindingType
from textual.containers import Horizontal
from textual.content import Content
from textual.renderables.digits import DIGITS, DIGITS3X3

from capture_app.common.address import LOOPBACK_HOSTS, parse_address
from capture_app.common.errors import IncompleteError, SimulshotError
from capture_app.common.pairing_codes import show_code
from capture_app.common.text import count, printable
from capture_app.protocol.orders import PhoneInvited
from capture_app.protocol.pairing_messages import Invite, Invited
from capture_app.protocol.status import LogLine, RigStatus
from capture_app.rig.rig_link import RigLink
from capture_app.tui.question import BoxDialog
from capture_app.tui.rig_record import RecordChanged
from capture_app.tui.widgets.lines import Lines, log_lines

DEVICE = "v4l2:/dev/video0"
QUIET = 2
"""Light margin around the code, in modules; scanning from a screen needs only two."""
_HALF = {(True, True): "█", (True, False): "▀", (False, True): "▄", (False, False): " "}
LOOK_EVERY_S = 1.0
MAX_LOG_LINES = 2
INVITE = "invite"
"""Name of the dialog that can show another code."""
BROWSER_STEP = "2  The browser warns once that it does not know this machine: choose Advanced, then continue."
PHONE_STEPS = (
    "1  Scan the code with the phone, and open the page.",
    BROWSER_STEP,
    "3  Start the camera and allow access. Place the phone and plug it in.",
)
MAX_MISSING = 4
"""Views named at a time that a board has not covered."""
_COVERED = ("The coverage is complete: record half a minute in which the board moves like this.", "$success")
_USED = ("The last code was used or has expired. For the next device:", "$success")


def large(code: str) -> list[str]:
    """Return a numeric code in digits three lines high."""
    return ["".join(DIGITS3X3[DIGITS.index(letter) * 3 + row] for letter in code) for row in range(3)]


def joining_line(leader: str) -> str:
    """Return the command to run on a camera's machine."""
    return f"capture-app node --leader {leader} --camera {DEVICE}"


def joining_place(leader: str) -> str:
    """Return where to type that command."""
    return (
        "This rig accepts this machine only. Type here:"
        if parse_address(leader).host in LOOPBACK_HOSTS
        else "On the camera's machine, type:"
    )


def qr_lines(text: str) -> list[Content]:
    """Return a QR code in half blocks; the light modules are drawn, on a dark background."""
    light = [
        [not module for module in row]
        for row in segno.make(text, error="l", boost_error=False, micro=False).matrix_iter(border=QUIET)
    ]
    if len(light) % 2:
        light.append([False] * len(light[0]))
    return [
        Content.styled("".join(_HALF[pair] for pair in zip(upper, lower, strict=True)), "#ffffff on #000000")
        for upper, lower in zip(light[::2], light[1::2], strict=True)
    ]


GUIDES = "simulshot.guides"


class Guide(Protocol):
    """A companion's dialog; one is made for a rig, and it may be shown again."""

    TITLE: str
    WIDTH: int
    """Width of the text in cells."""

    def __init__(
        self, source: RigLink, *, is_local: bool, run: Callable[[Coroutine[None, None, None]], object]
    ) -> None:
        """`source`: the rig, whose leader may be on this machine; `run` runs work until the screen ends."""

    async def show(self, screen: "GuideScreen") -> None:
        """Show the instructions, until the dialog is closed."""


class GuideScreen(BoxDialog[None]):
    """Dialog with instructions, a QR code beside them, and log lines received since it opened."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("i", "begin", "Invite", id="invite.another", tooltip="another code"),
    ]

    def __init__(
        self,
        name: str,
        title: str,
        width: int,
        guide: "Callable[[GuideScreen], Coroutine[None, None, None]]",
    ) -> None:
        """`width`: cells for the text; `guide`: coroutine that shows it, run until the screen is closed."""
        self._width, self._guide = width, guide
        self.url = ""
        """Content of the QR code."""
        self._words = Lines(id=f"{name}-words", classes="words")
        self._code = Lines(id=f"{name}-code", classes="code")
        self._event_log, self._came = deque[LogLine](maxlen=MAX_LOG_LINES), Lines(id=f"{name}-news")
        super().__init__(title, Horizontal(self._words, self._code), self._came, subtitle="esc closes")
        self.id = f"{name}-guide"

    def on_mount(self) -> None:
        """Start the guide once the dialog is visible, as it may load a web server."""
        self.show("", ("Preparing …", ""))
        self.call_after_refresh(self.action_begin)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Offer another code only where the guide shows one."""
        return action != "begin" or self.id == f"{INVITE}-guide"

    def action_begin(self) -> None:
        """Run the guide from its beginning; an invitation then shows another code."""
        self.run_worker(self._guide(self), exclusive=True, group="guide")

    def on_record_changed(self, message: RecordChanged) -> None:
        """Show new log lines."""
        if isinstance(message.what, LogLine):
            self._event_log.append(message.what)
            self._came.show(log_lines(self._event_log, self._came.size.width))

    def show(self, url: str, *paragraphs: tuple[str, str]) -> None:
        """Show a QR code (empty: none) and paragraphs with their styles; numbered ones are indented."""
        self.url = url
        self._code.show(qr_lines(url) if url else [])
        self._words.show(
            [
                Content.styled(line, style)
                for text, style in paragraphs
                for line in textwrap.wrap(
                    printable(text), self._width, subsequent_indent="   " if text[:1].isdigit() else ""
                )
                or [""]
            ]
        )


async def invite_machine(source: RigLink, leader: str, screen: GuideScreen) -> None:
    """Show the command for another machine, also as a QR code, and the pairing code."""
    command = joining_line(printable(leader))
    line = (joining_place(leader), ""), (command, "bold $secondary"), ("", "")
    try:
        invited = await source.ask(Invite(), Invited)
    except SimulshotError as error:
        screen.show(command, *line, (str(error).capitalize(), "$warning"))
        return
    code = show_code(invited.code)
    words = (
        f"An unpaired machine asks for this pairing code: {code}. It pairs one machine and expires after "
        f"{invited.good_for_s // 60} minutes. i shows another code; both stay valid."
    )
    screen.show(
        command, *line, *((row, "bold $success") for row in large(code)), (words, "$foreground-muted")
    )


async def show_coverage(source: RigLink, rig: RigStatus | None, screen: GuideScreen) -> None:
    """Show which views of the default board the cameras have, and which are missing, until none is.

    `rig`: its status, if it is known.
    """
    from capture_app.rig.board_coverage import watch_coverage  # loads OpenCV's detectors

    foot = (
        "Show the printed board (G in Rig makes it) to all cameras. Then take a burst of it, and "
        "calibrate from the board: A in Sessions. Another board: capture-app coverage --board",
        "$foreground-muted",
    )
    try:
        if rig is None:
            raise IncompleteError(f"{source.leader} has not answered yet", hint="start a rig, and try again")
        async with aclosing(watch_coverage(source.another(), rig)) as changes:
            async for found in changes:
                if not isinstance(found, str):
                    rows = [
                        (f"{name:<12} {count(seen.views, 'view')}, {100 * seen.covered:.0f} % covered", "")
                        for name, seen in found.cameras.items()
                    ]
                    state = [(text, "$warning") for text in found.missing[:MAX_MISSING]] or [_COVERED]
                    screen.show("", *rows, ("", ""), *state, ("", ""), foot)
    except SimulshotError as error:
        screen.show("", (str(error), "$warning"))


async def show_codes(
    ask: Callable[[], Awaitable[PhoneInvited]], steps: tuple[str, ...], screen: GuideScreen
) -> None:
    """Show the code of a page for the next device, forever; it changes with each device that joins."""
    shown = ""
    while True:
        try:
            invited = await ask()
            if invited.url != shown:
                screen.show(
                    invited.url,
                    *([_USED] if shown else []),
                    *((step, "") for step in steps),
                    ("", ""),
                    (invited.url, "bold $secondary"),
                    ("", ""),
                    (
                        "Each code admits one device and expires after ten minutes. On an untrusted network, "
                        "compare the certificate's SHA-256 in its browser with:",
                        "$foreground-muted",
                    ),
                    (invited.fingerprint, "$foreground-muted"),
                )
                shown = invited.url
        except SimulshotError as error:
            shown = ""
            screen.show("", (str(error), "$warning"))
        await asyncio.sleep(LOOK_EVERY_S)
