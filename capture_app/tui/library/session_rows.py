"""List of sessions with filter, order and three-line rows, and the pane of the selected session."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Literal, get_args

from rich.style import Style
from textual import work
from textual.containers import Vertical
from textual.content import Content
from textual.geometry import Size
from textual.strip import Strip

import capture_app
from capture_app.common.names import natural_order
from capture_app.common.text import count, megabytes, printable
from capture_app.session.library.listing import SessionCard, best_synchronized, load_thumbnail
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.session.reading.verdict import cap_grade, describe_spread, grade_of, is_incomplete
from capture_app.tui.jobs.run import run_tag
from capture_app.tui.jobs.runs import Runs
from capture_app.tui.signs import GRADES, Sign
from capture_app.tui.widgets.cells import CellPicture
from capture_app.tui.widgets.contact_sheet import ContactSheet
from capture_app.tui.widgets.lines import Lines, fitting, justified, strip_of_line, write_border
from capture_app.tui.widgets.picture import draw_for, strip_of_middle
from capture_app.tui.widgets.row_list import RowList

SAMPLES = "sample_sessions"


Order = Literal["newest first", "best synchronized first", "by name", "largest first"]
"""Sort order of sessions."""
ORDERS: tuple[Order, ...] = get_args(Order)
ROWS = 3
THUMB = 8
"""Columns of the thumbnail."""
LOW = 30
"""Height below which the pictures get the space of the explanations."""
STATES = {
    "being saved": Sign("◔", "being saved", "$warning"),
    "interrupted": Sign("✖", "interrupted", "$error"),
    "unreadable": Sign("✖", "unreadable", "$error"),
}


@dataclass(frozen=True, slots=True)
class Entry:
    """Session in the list."""

    card: SessionCard
    is_sample: bool = False
    """Whether the session came with the program and is read-only."""
    is_best: bool = False
    """Whether it is the best synchronized session listed."""

    @property
    def key(self) -> str:
        """Unique key of the entry: the absolute path of the session's folder."""
        return str(self.card.folder.absolute())


def arrange(
    sessions: Sequence[SessionCard],
    samples: Sequence[SessionCard],
    order: Order,
    words: str,
    further: Mapping[Path, int],
) -> list[Entry]:
    """Return the sessions whose displayed text contains all words, sorted; samples come last.

    `further`: bytes of each folder's session beyond its images, such as results.
    """
    found = [card for card in sessions if _matches(card, words)]
    best = best_synchronized(
        [card for card in found if not is_incomplete(card.missing, card.images + card.missing)]
    )
    return [
        *(Entry(card, is_best=card is best) for card in _sort(found, order, further)),
        *(
            Entry(card, is_sample=True)
            for card in _sort([c for c in samples if _matches(c, words)], order, further)
        ),
    ]


def find_samples(sessions: Path) -> Path | None:
    """Return the folder of bundled samples, here or beside the program, or None."""
    places = Path(SAMPLES), Path(capture_app.__file__).parents[1] / SAMPLES
    return next((one for one in places if one.is_dir() and one.resolve() != sessions.resolve()), None)


def _sort(cards: Sequence[SessionCard], order: Order, further: Mapping[Path, int]) -> list[SessionCard]:
    found = sorted(cards, key=lambda card: natural_order(card.name))
    if order == "best synchronized first":
        found.sort(key=lambda card: (card.worst_ns is None, card.missing > 0, card.worst_ns or 0))
    if order == "newest first":
        # A session being saved has no date yet and is the newest.
        found.sort(key=lambda card: (card.state == "being saved", card.created), reverse=True)
    if order == "largest first":
        found.sort(key=lambda card: -card.size_bytes - further.get(card.folder, 0))
    return found


def _matches(card: SessionCard, words: str) -> bool:
    text = " ".join((card.shown, card.note, card.origin, card.state, card.created[:10], *card.cameras))
    return all(word in text.casefold() for word in words.casefold().split())


class SessionRows(RowList[Entry]):
    """List of sessions, three lines each."""

    def __init__(self, thumbnails: Path, runs: Runs) -> None:
        """`thumbnails`: the cache folder of thumbnails."""
        super().__init__(ROWS, self._draw_entry, id="sessions")
        self._cache = thumbnails
        self._runs = runs
        self._thumbs: dict[Path | None, CellPicture | None] = {}
        self._requested: list[str] = []
        self.further: dict[Path, int] = {}
        """Bytes beyond its images of each folder's session: its results, or all of an incomplete one.

        Those of the trash are under its folder.
        """

    def _draw_entry(self, entry: Entry, width: int, chosen: bool) -> Sequence[Content | Strip]:
        """Draw the thumbnail beside three lines."""
        room = width - THUMB - 3
        notes = _notes(entry.card, self.further.get(entry.card.folder, 0))
        last = Content.styled(" · ", "$foreground-muted").join(notes)
        lines, plain = [self._title(entry, room), self._facts(entry.card, room), last], self.rich_style
        style = "on $block-cursor-background" if chosen else ""
        mark = strip_of_line(self, Content.styled("▌" if chosen else " ", "$primary").stylize_before(style))

        def beside(line: Content) -> Strip:
            line = Content.assemble(" ", line.truncate(room, ellipsis=True, pad=True), " ")
            return strip_of_line(self, line.stylize_before(style))

        return [
            Strip.join([mark, self._thumb_line(entry, at, plain), beside(line)])
            for at, line in enumerate(lines)
        ]

    def notify_style_update(self) -> None:
        """Redraw the thumbnails, because the palette may have changed."""
        self._thumbs.clear()
        super().notify_style_update()

    def _title(self, entry: Entry, room: int) -> Content:
        card = entry.card
        left = Content.styled(printable(card.shown), "bold")
        if entry.is_best:
            left += Content.styled("  ★ best synchronized", "bold $warning")
        if entry.is_sample:
            left += Content.styled("  sample", "$secondary")
        return justified(left, Content.styled(_when(card.created), "$foreground-muted"), room)

    def _facts(self, card: SessionCard, room: int) -> Content:
        if card.state != "complete":
            sign = STATES[card.state]
            return Content.styled(f"{sign}: {printable(card.problem)}", sign.style)
        time_difference = scatter_of(card)
        tags = fitting(map(run_tag, self._runs.of(card.folder)), "  ", room - time_difference.cell_length - 2)
        return justified(time_difference, Content("  ").join(tags), room)

    def _thumb_line(self, entry: Entry, line: int, plain: Style) -> Strip:
        image = entry.card.first_image
        thumb = self._thumbs.get(image)
        if thumb is None:
            if image and image not in self._thumbs and entry.key not in self._requested:
                self._requested.append(entry.key)
                if len(self._requested) == 1:
                    self._load()
            return Strip.blank(THUMB, plain)
        return strip_of_middle(thumb, line, Size(THUMB, ROWS), plain, plain)

    @work(group="thumbnails")
    async def _load(self) -> None:
        """Load newly visible thumbnails in a thread, latest first."""
        while self._requested:
            key = self._requested[-1]
            image = self.items[key].card.first_image if key in self.items else None
            if image:
                self._thumbs[image] = await draw_for(
                    self.app, partial(load_thumbnail, self._cache, image), Size(THUMB, ROWS)
                )
            self._requested.remove(key)
            self.show_again(key)


def _notes(card: SessionCard, further: int) -> Iterator[Content]:
    if card.state != "complete":
        yield Content.styled(megabytes(further), "$foreground-muted")
        yield Content.styled(f"→ {printable(card.remedy)}", "$foreground")
        return
    what = f"{count(len(card.cameras), 'camera')} × {count(card.instants, 'instant')}"
    yield Content.styled(what, "$foreground-muted")
    if card.absent:
        yield Content.styled(f"! {printable(card.absent)}", "$warning")
    if card.missing:
        state = ("◔", "arriving", "$primary") if card.arriving else ("!", "missing", "$warning")
        yield Content.styled(f"{state[0]} {count(card.missing, 'image')} {state[1]}", state[2])
    if card.late:
        yield Content.styled(f"! {card.late} late", "$warning")
    # After the warnings, which its length must not cut.
    results = f" + results {megabytes(further)}" if further else ""
    yield Content.styled(megabytes(card.size_bytes) + results, "$foreground-muted")
    if card.note:
        yield Content(printable(card.note))


def scatter_of(card: SessionCard) -> Content:
    """Return a session's grade and the time difference that it rates, uncertainty included.

    Without a grade, return the reason.
    """
    if card.unsynchronized:
        return Content.styled(f"{GRADES['unknown'].glyph} not synchronized", "$foreground-muted")
    if not card.images and not card.arriving:
        return Content.styled(f"{GRADES['unknown'].glyph} not taken", "$foreground-muted")
    if card.spread_ns is None:
        return Content.styled(
            "one camera" if len(card.cameras) == 1 else "nothing to compare", "$foreground-muted"
        )
    if not card.arriving and is_incomplete(card.missing, card.images + card.missing):
        sign = GRADES["poor"]
        return Content.assemble(
            (str(sign), f"bold {sign.style}"),
            f"  {card.missing} of {count(card.images + card.missing, 'image')} missing",
        )
    error_ns = None if card.uncertainty_ns is None else 2 * card.uncertainty_ns
    grade, _ = grade_of(card.spread_ns, error_ns)
    grade = grade if card.arriving else cap_grade(grade, card.loss, card.missing, card.images + card.missing)
    sign = GRADES[grade]
    if error_ns is None:
        return Content.styled(f"{sign.glyph} not measured", "$foreground-muted")
    return Content.assemble(
        (str(sign), f"bold {sign.style}"), f"  {describe_spread(card.spread_ns, error_ns)}"
    )


def _when(created: str) -> str:
    """Return the time of the take in the local time zone."""
    try:
        return datetime.fromisoformat(created).astimezone().strftime("%d %b %Y %H:%M")
    except ValueError:
        return printable(created[:16])


class TakePane(Vertical):
    """Pane of a session; the caller loads the sheet."""

    def __init__(self) -> None:
        self.entry: Entry | None = None
        """Session on display."""
        self.sheet = ContactSheet()
        self._words = Lines(id="take-words")
        super().__init__(self._words, self.sheet)

    def show(self, entry: Entry | None, sheet: TakeSheet | None) -> None:
        """Show a session; `sheet` is None if it is missing or not loaded yet."""
        self.entry = entry
        card = None if entry is None else entry.card
        facts = (count(len(card.cameras), "camera"), megabytes(card.size_bytes), card.folder) if card else ()
        write_border(self, None, printable(" · ".join(map(str, facts))))
        if sheet is not self.sheet.sheet:
            self.sheet.show(sheet)
        self._show_words()

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
            yield from Content.assemble(
                (f"{sign.glyph} ", f"bold {sign.style}"), (printable(verdict.headline), "bold")
            ).wrap(width)
        if card.note:
            note = Content.assemble(("note  ", "$foreground-muted"), printable(card.note))
            yield from [note.truncate(width, ellipsis=True)] if low else note.wrap(width)

    on_resize = _show_words
