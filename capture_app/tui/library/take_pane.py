"""Pane of one session: its verdict and its contact sheet."""

from collections.abc import Iterator
from typing import ClassVar

from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.content import Content

from capture_app.common.text import count, printable
from capture_app.session.library.listing import SessionCard
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.tui.library.session_rows import STATES, Entry
from capture_app.tui.signs import GRADES
from capture_app.tui.widgets.contact_sheet import ContactSheet
from capture_app.tui.widgets.lines import Lines
from capture_app.tui.widgets.look import Motion

LOW = 30
"""Height below which the pictures get the space of the explanations."""


class TakePane(Vertical):
    """Pane of a session; the caller loads the sheet."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("b", "look('cameras')", "Blink cameras", id="take.blink", tooltip="alternate two cameras"),
        Binding(
            "w", "look('wiggle')", "Wiggle", id="take.wiggle", tooltip="back and forth through the cameras"
        ),
    ]

    def __init__(self) -> None:
        self.entry: Entry | None = None
        """Session on display."""
        self.sheet = ContactSheet()
        self._words = Lines(id="take-words")
        super().__init__(self._words, self.sheet)

    def show(self, entry: Entry | None, sheet: TakeSheet | None) -> None:
        """Show a session; `sheet` is None if it is missing or not loaded yet."""
        self.entry = entry
        facts = () if entry is None else (count(len(entry.card.cameras), "camera"), str(entry.card.folder))
        self.border_subtitle = Content(printable(" · ".join(facts)))
        if sheet is not self.sheet.sheet:
            self.sheet.show(sheet)
        self._show_words()

    def action_look(self, motion: Motion) -> None:
        """Open the selected picture, in motion."""
        self.sheet.action_look(motion)

    def _show_words(self) -> None:
        self._words.show(() if self.entry is None else self._lines(self.entry.card, self.sheet.sheet))

    def _lines(self, card: SessionCard, sheet: TakeSheet | None) -> Iterator[Content]:
        width, low = max(20, self.size.width - 2), self.size.height < LOW
        if card.state != "complete":
            sign = STATES[card.state]
            yield from Content.styled(f"{sign}: {printable(card.problem)}", sign.style).wrap(width)
            yield from Content(f"→ {printable(card.remedy)}").wrap(width)
        elif sheet is not None and sheet.session.folder == card.folder:
            verdict, sign = sheet.verdict, GRADES[sheet.verdict.grade]
            yield Content.assemble(
                (f"{sign.glyph} ", f"bold {sign.style}"), (printable(verdict.headline), "bold")
            ).truncate(width, ellipsis=True)
        if card.note:
            note = Content.assemble(("note  ", "$foreground-muted"), printable(card.note))
            yield from [note.truncate(width, ellipsis=True)] if low else note.wrap(width)

    on_resize = _show_words
