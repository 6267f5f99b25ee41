"""Screen of a mode: header with tabs and the rig's state, a view, and the key footer."""

from collections.abc import Iterator
from typing import ClassVar

from textual import events
from textual.app import ComposeResult
from textual.containers import Vertical
from textual.content import Content
from textual.geometry import Size
from textual.screen import Screen
from textual.style import Style
from textual.widgets import Static

from capture_app.common.text import printable
from capture_app.protocol.status import RigStatus
from capture_app.rig.rig_link import LinkLost
from capture_app.tui.rig_record import RecordChanged, RigRecord
from capture_app.tui.signs import NO_LEADER, WAITING, rig_sign
from capture_app.tui.widgets.key_footer import KeyFooter
from capture_app.tui.widgets.lines import Lines, fitting, justified

MODES = {"rig": "Rig", "shoot": "Shoot", "sessions": "Sessions", "jobs": "Jobs"}
"""Titles by mode, in the order of their keys 1 to 4."""
MIN_SIZE = Size(60, 16)
"""Columns and rows below which no mode has room."""


class Header(Lines):
    """Mode tabs, which can be clicked, and as much of the rig's state as fits."""

    def __init__(self, mode: str, record: RigRecord) -> None:
        super().__init__(id="header")
        self._record = record
        self._tabs = Content("").join(
            Content.assemble(
                (f" {number} ", "bold $primary" if name != mode else "reverse bold $primary"),
                (f"{title} ", "$foreground" if name != mode else "reverse bold $primary"),
            ).stylize(Style.from_meta({"@click": f"app.switch_mode('{name}')"}))
            for number, (name, title) in enumerate(MODES.items(), 1)
        )

    def draw(self) -> None:
        """Draw the rig's state or the loss of its leader, most important part first."""
        parts = fitting(self._parts(), " · ", self.size.width - self._tabs.cell_length - 4)
        self.show([justified(self._tabs, Content(" · ").join(parts[::-1]) + " ", self.size.width)])

    on_resize = draw

    def _parts(self) -> Iterator[Content]:
        status = self._record.status
        sign = NO_LEADER if self._record.lost else WAITING if status is None else rig_sign(status)
        yield Content.styled(str(sign), f"bold {sign.style}")
        if self._record.ending:
            yield Content.styled(self._record.ending, "bold $warning")
        if status is None:
            return
        if status.order:
            yield Content.styled(printable(status.order), "$secondary")
        if status.is_open:
            yield Content.styled("OPEN: no pairing", "$warning")
        if (free := status.disk_free_bytes) is not None:
            mark, style = ("! ", "$error") if free < 2e9 else ("", "")
            yield Content.styled(f"{mark}{free / 1e9:.0f} GB free", style)
        yield Content.styled(printable(status.leader), "$foreground-muted")
        if status.period_ns:
            yield Content.styled(f"{1e9 / status.period_ns:.3g} fps", "$foreground-muted")


class ModeView(Vertical, can_focus=True):
    """Base class of a mode's view; its keys work while it, or a widget in it, has the focus.

    While visible, it receives updates through `on_record_changed`; `on_mode_shown` follows when it becomes
    visible again. It makes requests by posting `SessionsRequested` and `ActionFailed`.
    """

    def on_mode_shown(self) -> None:
        """Focus the main widget. Called when the mode becomes visible."""
        if not self.has_focus_within:
            self.focus_first()

    def on_mode_hidden(self) -> None:
        """Called when another mode or a dialog covers this one."""

    def focus_first(self) -> None:
        """Focus the main widget; the view itself by default."""
        self.focus()


class ModeScreen(Screen[None]):
    """Screen of one mode, on which dialogs and whole-screen views may be pushed."""

    AUTO_FOCUS: ClassVar[str | None] = ""

    def __init__(self, mode: str, view: ModeView, record: RigRecord) -> None:
        super().__init__(id=f"mode-{mode}")
        self.view = view
        self._header = Header(mode, record)

    def compose(self) -> ComposeResult:
        """Yield the header, the view and the footer."""
        yield self._header
        yield self.view
        yield Static(
            f"This window is too small: it needs {MIN_SIZE.width} columns and {MIN_SIZE.height} rows.",
            id="too-small",
        )
        yield KeyFooter(id="footer")

    def on_resize(self) -> None:
        """Say that there is no room for the view, instead of a part of it."""
        was_tiny = self.has_class("tiny")
        self.set_class(self.size.width < MIN_SIZE.width or self.size.height < MIN_SIZE.height, "tiny")
        if was_tiny and not self.has_class("tiny") and self.is_current:
            self.call_after_refresh(self.view.on_mode_shown)  # what is hidden has no focus

    def on_screen_resume(self, _: events.ScreenResume) -> None:
        """Notify the view that it is visible."""
        self.call_after_refresh(self.view.on_mode_shown)

    def on_screen_suspend(self, _: events.ScreenSuspend) -> None:
        """Notify the view that it is hidden."""
        self.view.on_mode_hidden()

    def on_record_changed(self, message: RecordChanged) -> None:
        """Update the header."""
        if isinstance(message.what, RigStatus | LinkLost):
            self._header.draw()
