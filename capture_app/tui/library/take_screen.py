"""One session on the whole screen: words, contact sheet, and each picture full size."""

from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.content import Content

from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.text import count, printable
from capture_app.tui.drawing.lines import Lines
from capture_app.tui.footer import KeyFooter
from capture_app.tui.library.catalogue import Entry
from capture_app.tui.library.take_pane import TakePane
from capture_app.tui.question import Dialog
from capture_app.tui.sheets.contact_sheet import ContactSheet
from capture_app.tui.sheets.look import LookScreen, Motion


class TakeScreen(Dialog[None]):
    """Shows a session; Escape closes it."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(
            "b", "look('CAMERAS')", "Blink cameras", id="take.blink", tooltip="one camera after the other"
        ),
        Binding("w", "look('WIGGLE')", "Wiggle", id="take.wiggle", tooltip="to and fro between cameras"),
        Binding("escape,backspace", "close", "Back", id="take.back", key_display="esc"),
    ]
    DEFAULT_CSS = """
    TakeScreen { background: $background; }
    TakeScreen #take-title { dock: top; height: 1; background: $panel; }
    """

    def __init__(self, entry: Entry, sheet: TakeSheet) -> None:
        super().__init__()
        self._entry, self._sheet = entry, sheet
        self._title = Lines(id="take-title")
        self._pane = TakePane()

    def compose(self) -> ComposeResult:
        """Title, words and sheet, keys."""
        yield self._title
        yield self._pane
        yield KeyFooter()

    def on_mount(self) -> None:
        """Show it."""
        self._pane.show(self._entry, self._sheet)
        self._pane.sheet.focus()

    def on_resize(self) -> None:
        """Show as much of the title as fits."""
        card = self._entry.card
        what = f"{count(len(card.cameras), 'camera')} × {count(card.instants, 'instant')}"
        self._title.show(
            [
                Content.assemble(
                    (f" {printable(card.name)} ", "reverse bold $primary"),
                    (f"  {what}", "$foreground"),
                    (f"   {printable(str(card.folder))}", "$foreground-muted"),
                ).truncate(self.size.width, ellipsis=True)
            ]
        )

    def on_contact_sheet_chosen(self, message: ContactSheet.Chosen) -> None:
        """Look at one picture."""
        self._look(message.camera, message.instant)

    def action_look(self, motion: str) -> None:
        """Look at the picture under the cursor, in motion."""
        place = self._pane.sheet.place
        if place is not None:
            self._look(place.camera, place.instant, Motion[motion])

    def action_close(self) -> None:
        """Go back."""
        self.dismiss(None)

    def _look(self, camera: str, instant: int, motion: Motion = Motion.STILL) -> None:
        def come_back(seen: tuple[str, int] | None) -> None:
            if seen is not None:
                self._pane.sheet.go_to(*seen)

        self.app.push_screen(LookScreen(self._sheet, camera, instant, motion), come_back)
