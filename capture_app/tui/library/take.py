"""One session: what it is good for in words, its contact sheet, and each picture full size."""

from collections.abc import Iterator
from typing import ClassVar

from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.content import Content

from capture_app.session.library.listing import SessionCard, SessionState
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.text import count, printable
from capture_app.tui.library.session_rows import STATES, Entry
from capture_app.tui.signs import GRADES
from capture_app.tui.widgets.contact_sheet import ContactSheet
from capture_app.tui.widgets.lines import Lines
from capture_app.tui.widgets.whole_screen import WholeScreen

LOW = 30
"""Below this height pictures need the room more than words."""


class TakePane(Vertical):
    """Shows a session; the sheet is loaded by whoever shows it."""

    def __init__(self) -> None:
        self.entry: Entry | None = None
        """The session that is shown."""
        self.sheet = ContactSheet()
        self._words = Lines(id="take-words")
        super().__init__(self._words, self.sheet)

    def show(self, entry: Entry | None, sheet: TakeSheet | None) -> None:
        """Show a session; None: its sheet is not there, or not yet."""
        self.entry = entry
        if sheet is not self.sheet.sheet:
            self.sheet.show(sheet)
        self._show_words()

    def _show_words(self) -> None:
        self._words.show(() if self.entry is None else self._lines(self.entry.card, self.sheet.sheet))

    def _lines(self, card: SessionCard, sheet: TakeSheet | None) -> Iterator[Content]:
        width, low = max(20, self.size.width - 2), self.size.height < LOW
        if card.state is not SessionState.COMPLETE:
            sign = STATES[card.state]
            yield from Content.styled(f"{sign}: {printable(card.problem)}", sign.style).wrap(width)
            yield from Content(f"→ {printable(card.remedy)}").wrap(width)
        elif sheet is not None and sheet.session.folder == card.folder:
            verdict, sign = sheet.verdict, GRADES[sheet.verdict.grade]
            yield from Content.assemble(
                (f"{sign.glyph} ", f"bold {sign.style}"), (printable(verdict.headline), "bold")
            ).wrap(width)
            if not low:
                sentence = f"{verdict.spread} apart: {printable(verdict.sentence)}"
                yield from Content.styled(sentence, "$foreground-muted").wrap(width)
                if verdict.stamps:
                    yield from Content.styled(printable(verdict.stamps), "$warning").wrap(width)
        if card.note:
            note = Content.assemble(("note  ", "$foreground-muted"), printable(card.note))
            yield from [note.truncate(width, ellipsis=True)] if low else note.wrap(width)

    on_resize = _show_words


class TakeScreen(WholeScreen[None]):
    """Shows a session; Escape closes it."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(
            "b", "look('CAMERAS')", "Blink cameras", id="take.blink", tooltip="one camera after the other"
        ),
        Binding("w", "look('WIGGLE')", "Wiggle", id="take.wiggle", tooltip="to and fro between cameras"),
        Binding("escape,backspace", "dismiss", "Back", id="take.back", key_display="esc"),
    ]

    def __init__(self, entry: Entry, sheet: TakeSheet) -> None:
        self._pane = TakePane()
        super().__init__(self._pane)
        self._entry, self._sheet = entry, sheet

    def on_mount(self) -> None:
        """Show it."""
        self._pane.show(self._entry, self._sheet)
        self._pane.sheet.focus()

    def on_resize(self) -> None:
        """Show as much of the title as fits."""
        card = self._entry.card
        what = f"{count(len(card.cameras), 'camera')} × {count(card.instants, 'instant')}"
        self.title_line.show(
            [
                Content.assemble(
                    (f" {printable(card.name)} ", "reverse bold $primary"),
                    (f"  {what}", "$foreground"),
                    (f"   {printable(str(card.folder))}", "$foreground-muted"),
                ).truncate(self.size.width, ellipsis=True)
            ]
        )

    def action_look(self, motion: str) -> None:
        """Look at the picture under the cursor, in motion."""
        self._pane.sheet.action_look(motion)
