"""One session: what it is good for in words, and its contact sheet."""

from textual.app import ComposeResult
from textual.containers import Vertical
from textual.content import Content

from capture_app.session.library.listing import SessionState
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.session.reading.verdict import judge
from capture_app.text import printable
from capture_app.tui.drawing.lines import Lines
from capture_app.tui.library.catalogue import Entry
from capture_app.tui.library.session_rows import STATES
from capture_app.tui.sheets.contact_sheet import ContactSheet
from capture_app.tui.states import GRADES

LOW = 30
"""Below this height pictures need the room more than words."""


class TakePane(Vertical):
    """Shows a session; the sheet is loaded by whoever shows it."""

    DEFAULT_CSS = """
    TakePane #take-words { height: auto; padding: 0 1; margin-bottom: 1; }
    """

    def __init__(self) -> None:
        super().__init__()
        self._entry: Entry | None = None
        self.sheet = ContactSheet()
        self._words = Lines(id="take-words")

    def compose(self) -> ComposeResult:
        """The words above the sheet."""
        yield self._words
        yield self.sheet

    @property
    def entry(self) -> Entry | None:
        """What is shown."""
        return self._entry

    def show(self, entry: Entry | None, sheet: TakeSheet | None) -> None:
        """Show a session; None: its sheet is not there, or not yet."""
        self._entry = entry
        if sheet is not self.sheet.sheet:
            self.sheet.show(sheet)
        self._show_words()

    def on_resize(self) -> None:
        """Wrap anew."""
        self._show_words()

    def _show_words(self) -> None:
        width = max(20, self.size.width - 2)
        entry, sheet = self._entry, self.sheet.sheet
        if entry is None:
            self._words.show([])
            return
        card, low = entry.card, self.size.height < LOW
        lines: list[Content] = []
        if card.state is not SessionState.COMPLETE:
            sign = STATES[card.state]
            lines += Content.styled(f"{sign}: {printable(card.problem)}", sign.style).wrap(width)
            lines += Content(f"→ {printable(card.remedy)}").wrap(width)
        elif sheet is not None and sheet.session.folder == card.folder:
            verdict = judge(sheet.session.manifest)
            sign = GRADES[verdict.grade]
            lines += Content.assemble(
                (f"{sign.glyph} ", f"bold {sign.style}"), (printable(verdict.headline), "bold")
            ).wrap(width)
            if not low:
                sentence = f"{verdict.spread} apart: {printable(verdict.sentence)}"
                lines += Content.styled(sentence, "$foreground-muted").wrap(width)
                if verdict.stamps:
                    lines += Content.styled(printable(verdict.stamps), "$warning").wrap(width)
        if card.note:
            note = Content.assemble(("note  ", "$foreground-muted"), printable(card.note))
            lines += [note.truncate(width, ellipsis=True)] if low else note.wrap(width)
        self._words.show(lines)
