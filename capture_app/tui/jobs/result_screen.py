"""Whole-screen view of a result: verdict, tables, and pictures switched between the two conditions."""

import asyncio
import os
import re
from collections.abc import Iterator
from functools import partial
from itertools import count, groupby, zip_longest
from pathlib import Path
from typing import ClassVar

from textual import events
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.content import Content
from textual.widget import Widget

from capture_app.common.errors import BadInputError
from capture_app.common.text import printable
from capture_app.tui.jobs.results import ResultPicture, ResultTable, StudyResult, read_result
from capture_app.tui.jobs.run import Run
from capture_app.tui.rig_record import ActionFailed, telling
from capture_app.tui.widgets.cells import Image
from capture_app.tui.widgets.lines import Lines
from capture_app.tui.widgets.picture import Picture, Source
from capture_app.tui.widgets.whole_screen import WholeScreen

BLINK_S = 0.8
WIDE = 150
"""Width from which pictures and tables are shown side by side."""


def verdict_lines(text: str, width: int) -> list[Content]:
    """Return a verdict in lines of a width, its first sentence in bold."""
    # A narrow space keeps a number and its unit on one line.
    text = re.sub(r"(?<=\d) (?=(?:[mµn]?s|px|[cm]?m)\b|%)", "\u202f", printable(text))
    first, dot, rest = text.partition(". ")
    return Content.assemble((first + dot.strip(), "bold"), (f" {rest}" if rest else "", "$foreground")).wrap(
        width
    )


def figure_lines(result: StudyResult, width: int) -> Iterator[Content]:
    """Yield the verdict, the tables and the notes, in lines of a width."""
    yield from (*verdict_lines(result.verdict, width), Content(""))
    for table in result.tables:
        yield from (*_table(table, width), Content(""))
    for remark in result.remarks:
        yield from Content.styled(printable(remark), "$foreground-muted").wrap(width)


def _table(table: ResultTable, width: int) -> Iterator[Content]:
    """Yield a table in lines: groups above the columns, numbers right-aligned."""
    rows = [tuple(printable(cell) for cell in row) for row in table.rows]
    columns = zip_longest(table.columns, *(row[1:] for row in rows), fillvalue="")
    widths = [max(map(len, column)) for column in columns]
    longest = max((len(row[0]) for row in rows), default=12)
    name = max(12, min(longest, width - sum(widths) - 2 * len(widths)))
    yield Content.styled(printable(table.caption), "bold $primary").truncate(width, ellipsis=True)
    if any(table.groups):
        groups = "".join(
            f"  {_cut(group.replace('Things at rest', 'At rest'), room):>{room}}"
            for group, room in _spans(table, widths)
        )
        yield Content.styled(f"{'':<{name}}{groups}", "$foreground-muted")
    heads = "".join(f"  {head:>{room}}" for head, room in zip(table.columns, widths, strict=True))
    yield Content.styled(f"{'':<{name}}{heads}", "$foreground-muted")
    styles = [_style(table, at) for at in range(len(widths))]
    for row in rows:
        cells = zip(row[1:], widths, styles, strict=False)
        parts = [Content.styled(f"  {cell:>{room}}", style) for cell, room, style in cells]
        yield Content("").join([Content(f"{_cut(row[0], name):<{name}}"), *parts])


def _style(table: ResultTable, at: int) -> str:
    """Return a column's style: alternating for synchronized and offset, neutral for all other columns."""
    if "rest" in table.groups[at] or "still" in table.columns[at]:
        return "$foreground-muted"
    if not any(table.groups) and len(table.columns) not in (2, 3):
        return "$foreground"
    return "$error" if at % 2 else "bold $success"


def _spans(table: ResultTable, widths: list[int]) -> Iterator[tuple[str, int]]:
    """Yield each group of neighbouring columns and its width in cells; a column without a group is alone."""
    columns = zip(count(), table.groups, widths, strict=False)
    for (group, _), found in groupby(columns, key=lambda column: (column[1], column[1] or column[0])):
        rooms = [room for _, _, room in found]
        yield group, sum(rooms) + 2 * (len(rooms) - 1)


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else text[: max(0, width - 1)] + "…"


class ResultScreen(WholeScreen[None]):
    """Screen of one result; Escape closes it."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("space,s", "switch", "Synced/offset", id="result.switch", key_display="space"),
        Binding("right,n", "move(1)", "Next picture", id="result.next", key_display="→"),
        Binding("left,p", "move(-1)", "Previous picture", id="result.previous", show=False, key_display="←"),
        Binding("b", "blink", "Blink", id="result.blink"),
        Binding("f,tab", "figures", "Figures", id="result.figures", key_display="f"),
        Binding("o", "report", "Report", id="result.report"),
        Binding("escape,backspace", "dismiss", "Back", id="result.back", key_display="esc"),
    ]

    def __init__(self, run: Run, result: StudyResult) -> None:
        self._verdict = Lines(id="result-verdict")
        self._words = Lines(id="result-figures")
        self._sides = Lines(id="result-sides")
        self._picture = Picture(words="no picture", id="result-picture")
        self._caption = Lines(id="result-caption")
        self._text = VerticalScroll(self._words, id="result-words")
        pictures = (self._verdict, self._sides, self._picture, self._caption)
        self._pictures = Vertical(*pictures, id="result-pictures")
        super().__init__(Horizontal(self._text, self._pictures))
        self._run, self._result = run, result
        self._at = 0
        self.shows_offset = False
        """Whether the offset condition is shown."""
        self._figures = not result.pictures
        self._blinks = False
        self._sources: dict[Path, Source] = {}

    def on_mount(self) -> None:
        """Start the timer that blinks the conditions."""
        self.set_interval(BLINK_S, self._blink)

    @property
    def picture(self) -> ResultPicture | None:
        """Picture on display."""
        return next(iter(self._result.pictures[self._at :]), None)

    # Actions

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Offer only what this result contains."""
        seen = not self._figures or self._is_wide
        return {
            "switch": seen and self._has_two_conditions,
            "blink": seen and self._has_two_conditions,
            "move": seen and len(self._result.pictures) > 1,
            "figures": bool(self._result.pictures) and not self._is_wide,
            "report": self._run.report is not None,
        }.get(action, True)

    def action_switch(self) -> None:
        """Show the other condition."""
        self._blinks = False
        self._turn()

    def action_blink(self) -> None:
        """Start or stop alternating between both conditions."""
        self._blinks = not self._blinks
        self._show_picture()

    def action_move(self, by: int) -> None:
        """Show another picture in the same condition."""
        self._at = (self._at + by) % len(self._result.pictures)
        self._show_picture()

    def on_click(self, event: events.Click) -> None:
        """Switch the condition after a click on the picture or on the labels above it."""
        if event.widget in (self._picture, self._sides) and self._has_two_conditions:
            self.action_switch()

    def action_figures(self) -> None:
        """Switch between tables and pictures."""
        self._figures = not self._figures
        self._lay_out()

    def action_report(self) -> None:
        """Open the report in the browser."""
        open_report(self, self._run.report)

    # Drawing

    @property
    def _has_two_conditions(self) -> bool:
        return self.picture is not None and self.picture.offset is not None

    @property
    def _is_wide(self) -> bool:
        return self.size.width >= WIDE

    def _lay_out(self) -> None:
        self.set_class(self._is_wide, "-wide")
        both = self._is_wide and bool(self._result.pictures)
        self._text.display = both or self._figures
        self._pictures.display = both or not self._figures
        if self._figures and not both:
            self._text.focus()
        self.call_after_refresh(self._show)

    on_resize = _lay_out

    def _show(self) -> None:
        width = max(24, self._text.scrollable_content_region.width or self.size.width - 4)
        self.title_line.show(
            [
                Content.assemble(
                    (f" {self._run.command.title} ", "reverse bold $primary"),
                    (f" {printable(self._run.session.name)}", "bold"),
                    (f"   {printable(str(self._run.out))}", "$foreground-muted"),
                ).truncate(self.size.width, ellipsis=True)
            ]
        )
        self._words.show(figure_lines(self._result, width))
        room = max(24, self.size.width - 4)
        self._verdict.show(verdict_lines(self._result.verdict, room))
        self._show_picture()

    def _show_picture(self) -> None:
        picture = self.picture
        if picture is None:
            return
        path = picture.synced if picture.offset is None or not self.shows_offset else picture.offset
        self.shows_offset = path is picture.offset
        source = self._sources.setdefault(path, partial(_read, path))
        sharp = None if self._blinks else source
        self._picture.show(source, f"{path.name} is gone: run the job again", sharp=sharp)
        sides = []
        if picture.offset is not None:
            for words, seen, style in (
                (picture.synced_words, not self.shows_offset, "$success"),
                (picture.offset_words, self.shows_offset, "$error"),
            ):
                look = f"reverse bold {style}" if seen else "$foreground-muted"
                sides.append(Content.styled(f" {'●' if seen else '○'} {words} ", look))
        place = f"{self._at + 1}/{len(self._result.pictures)}  {printable(picture.title)}"
        line = Content("  ").join(sides)
        gap = self._sides.scrollable_content_region.width - line.cell_length - len(place)
        self._sides.show([Content.assemble(line, " " * max(2, gap), (place, "bold"))])
        width = max(24, self._caption.scrollable_content_region.width)
        self._caption.show(Content.styled(printable(picture.caption), "$foreground-muted").wrap(width)[:3])
        self.refresh_bindings()

    def _blink(self) -> None:
        if self._blinks:
            self._turn()

    def _turn(self) -> None:
        self.shows_offset = not self.shows_offset
        self._show_picture()


def open_report(widget: Widget, report: Path | None) -> None:
    """Open a report in the browser; over SSH, show its path instead."""
    if report is None or not report.is_file():
        error = BadInputError("the report is gone", hint="run the job again")
        widget.post_message(ActionFailed(error))
        return
    path = report.resolve()
    if "SSH_CONNECTION" in os.environ or "SSH_TTY" in os.environ:
        widget.app.notify(f"The report is on this machine: {path}", markup=False, timeout=30)
    else:
        widget.app.open_url(path.as_uri())
        widget.app.notify(f"Opened {path}", markup=False)


def _read(path: Path) -> bytes | Image | None:
    try:
        return path.read_bytes()
    except OSError:
        return None


async def show_result(widget: Widget, run: Run) -> None:
    """Show a run's result on the whole screen, or an error if it cannot be read."""
    with telling(widget):
        result = await asyncio.to_thread(read_result, run)
        await widget.app.push_screen(ResultScreen(run, result))
