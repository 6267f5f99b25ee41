"""The screen of a mode: header, the mode's view, keys; and what every view is."""

from typing import ClassVar

from textual import events
from textual.app import ComposeResult
from textual.containers import Vertical
from textual.screen import Screen

from capture_app.protocol.status import RigStatus
from capture_app.rig.link import LinkLost
from capture_app.tui.rig_record import RigRecord, Told
from capture_app.tui.widgets.footer import KeyFooter
from capture_app.tui.widgets.header import Header


class ModeView(Vertical, can_focus=True):
    """Fills a mode. Its keys hold while it, or a widget in it, has the focus.

    It is told of what changes by `on_told` while it is seen; `on_mode_shown` says that it is seen again. It
    asks by posting `SessionsRequested` and `Mishap`.
    """

    def on_mode_shown(self) -> None:
        """Called when the user comes to this mode; puts the focus where the work is."""
        if not self.has_focus_within:
            self.focus_first()

    def on_mode_hidden(self) -> None:
        """Called when another mode or a dialog covers this one."""

    def focus_first(self) -> None:
        """Put the focus on what the user drives here; on the view itself where that is all."""
        self.focus()


class ModeScreen(Screen[None]):
    """A mode of the app: one of these for each, on which dialogs and whole-screen views may be pushed."""

    AUTO_FOCUS: ClassVar[str | None] = ""

    def __init__(self, mode: str, view: ModeView, record: RigRecord) -> None:
        super().__init__(id=f"mode-{mode}")
        self.view = view
        self._header = Header(mode, record)

    def compose(self) -> ComposeResult:
        """Lay the screen out."""
        yield self._header
        yield self.view
        yield KeyFooter()

    def on_screen_resume(self, _: events.ScreenResume) -> None:
        """Tell the view that it is seen."""
        self.call_after_refresh(self.view.on_mode_shown)

    def on_screen_suspend(self, _: events.ScreenSuspend) -> None:
        """Tell the view that it is not seen."""
        self.view.on_mode_hidden()

    def on_told(self, message: Told) -> None:
        """Show the rig in the header."""
        if isinstance(message.what, RigStatus | LinkLost):
            self._header.draw()
