"""Screen of a mode, with header, view and key footer, and the base class of all views."""

from typing import ClassVar

from textual import events
from textual.app import ComposeResult
from textual.containers import Vertical
from textual.screen import Screen

from capture_app.protocol.status import RigStatus
from capture_app.rig.rig_link import LinkLost
from capture_app.tui.rig_record import RecordChanged, RigRecord
from capture_app.tui.widgets.footer import KeyFooter
from capture_app.tui.widgets.header import Header


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
        yield KeyFooter()

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
