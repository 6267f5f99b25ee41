"""The screen of a mode: header, the mode's view, keys; and what every view is."""

from typing import ClassVar

from textual import events
from textual.app import ComposeResult
from textual.containers import Vertical
from textual.screen import Screen
from textual.widget import Widget

from capture_app.tui.rig_record import LinkChanged, NewsReceived, PreviewReceived, StatusChanged
from capture_app.tui.widgets.footer import KeyFooter
from capture_app.tui.widgets.header import Header


class ModeView(Vertical, can_focus=True):
    """Fills a mode. Its keys hold while it, or a widget in it, has the focus.

    It is told of the rig by `on_status_changed`, `on_news_received`, `on_preview_received` and
    `on_link_changed` while it is seen; `on_mode_shown` says that it is seen again, `on_show_sessions` tells
    the mode Sessions what to show. It asks by posting `ModeRequested`, `SessionsRequested` and `Mishap`.
    """

    DEFAULT_CSS = "ModeView { height: 1fr; width: 1fr; }"

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

    def __init__(self, mode: str, view: Widget) -> None:
        super().__init__(id=f"mode-{mode}")
        self.view = view
        self._header = Header(mode)

    def compose(self) -> ComposeResult:
        """Lay the screen out."""
        yield self._header
        yield self.view
        yield KeyFooter()

    def on_screen_resume(self, _: events.ScreenResume) -> None:
        """Tell the view that it is seen."""
        if isinstance(self.view, ModeView):
            self.call_after_refresh(self.view.on_mode_shown)
        elif self.focused is None:
            self.view.focus()

    def on_screen_suspend(self, _: events.ScreenSuspend) -> None:
        """Tell the view that it is not seen."""
        if isinstance(self.view, ModeView):
            self.view.on_mode_hidden()

    def on_status_changed(self, message: StatusChanged) -> None:
        """Show the rig in the header, and tell the view."""
        self._header.show_status(message.status)
        self.view.post_message(StatusChanged(message.status))

    def on_link_changed(self, message: LinkChanged) -> None:
        """Show it in the header, and tell the view."""
        self._header.show_link(message.reason)
        self.view.post_message(LinkChanged(message.reason))

    def on_news_received(self, message: NewsReceived) -> None:
        """Tell the view."""
        self.view.post_message(NewsReceived(message.news))

    def on_preview_received(self, message: PreviewReceived) -> None:
        """Tell the view."""
        self.view.post_message(PreviewReceived(message.preview))
