"""A result on the whole screen: verdict, figures, and pictures switched between both conditions by a key.

A result in words: verdict and tables as lines of the screen.
"""

import os
import re
from functools import partial
from pathlib import Path
from typing import ClassVar

from textual import events
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.content import Content
from textual.timer import Timer
from textual.widget import Widget

from capture_app.errors import BadInputError
from capture_app.text import printable
from capture_app.tui.jobs.job import Job
from capture_app.tui.jobs.results import ResultPicture, ResultTable, StudyResult
from capture_app.tui.question import Dialog
from capture_app.tui.rig_record import Mishap
from capture_app.tui.widgets.cells import Image
from capture_app.tui.widgets.footer import KeyFooter
from capture_app.tui.widgets.lines import Lines
from capture_app.tui.widgets.picture import Picture, Source


def verdict_lines(text: str, width: int) -> list[Content]:
    """A verdict in lines, its first sentence in bold."""
    # A narrow space keeps a number and its unit on one line.
    text = re.sub(r"(?<=\d) (?=(?:[mµn]?s|px|[cm]?m)\b|%)", "\u202f", printable(text))
    first, dot, rest = text.partition(". ")
    return Content.assemble((first + dot.strip(), "bold"), (f" {rest}" if rest else "", "$foreground")).wrap(
        width
    )


def figure_lines(result: StudyResult, width: int) -> list[Content]:
    """The verdict, the tables, and what was not measured, in lines of a width."""
    lines = [*verdict_lines(result.verdict, width), Content("")]
    for table in result.tables:
        lines += [*_table(table, width), Content("")]
    for remark in result.remarks:
        lines += Content.styled(printable(remark), "$foreground-muted").wrap(width)
    return lines


def _table(table: ResultTable, width: int) -> list[Content]:
    """A table as lines: groups above the conditions, numbers to the right."""
    columns = len(table.columns)
    cells = [tuple(printable(cell) for cell in row) for row in table.rows]
    widths = [
        max([len(table.columns[at]), *(len(row[at + 1]) for row in cells if at + 1 < len(row))])
        for at in range(columns)
    ]
    spans = _spans(table, widths)
    name = max(12, min(max((len(row[0]) for row in cells), default=12), width - sum(widths) - 2 * columns))
    lines = [Content.styled(printable(table.caption), "bold $primary").truncate(width, ellipsis=True)]
    if any(table.groups):
        groups = "".join(
            f"  {_cut(group.replace('Things at rest', 'At rest'), room):>{room}}" for group, room in spans
        )
        lines.append(Content.styled(f"{'':<{name}}{groups}", "$foreground-muted"))
    heads = "".join(f"  {head:>{room}}" for head, room in zip(table.columns, widths, strict=True))
    lines.append(Content.styled(f"{'':<{name}}{heads}", "$foreground-muted"))
    for row in cells:
        line = Content(f"{_cut(row[0], name):<{name}}")
        for at, (cell, room) in enumerate(zip(row[1:], widths, strict=False)):
            synced = at % 2 == 0
            style = "$foreground" if columns == 1 else "bold $success" if synced else "$error"
            if "rest" in table.groups[at] or "still" in table.columns[at]:
                style = "$foreground-muted"
            line += Content.styled(f"  {cell:>{room}}", style)
        lines.append(line)
    return lines


def _spans(table: ResultTable, widths: list[int]) -> list[tuple[str, int]]:
    """Each group of neighbouring columns and the cells that it spans."""
    spans: list[tuple[str, int]] = []
    for at, (group, room) in enumerate(zip(table.groups, widths, strict=True)):
        if spans and group and group == table.groups[at - 1]:
            spans[-1] = (group, spans[-1][1] + room + 2)
        else:
            spans.append((group, room))
    return spans


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else text[: max(0, width - 1)] + "…"


BLINK_S = 0.8
WIDE = 150
"""From this width on pictures and figures stand side by side."""


class ResultScreen(Dialog[None]):
    """Shows one result; Escape closes it."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("space,s", "switch", "Synced/offset", id="result.switch", key_display="space"),
        Binding("right,n", "move(1)", "Next picture", id="result.next", key_display="→"),
        Binding("left,p", "move(-1)", "Previous picture", id="result.previous", show=False, key_display="←"),
        Binding("b", "blink", "Blink", id="result.blink"),
        Binding("f,tab", "figures", "Figures", id="result.figures", key_display="f"),
        Binding("o", "report", "Report", id="result.report"),
        Binding("escape,backspace", "close", "Back", id="result.back", key_display="esc"),
    ]
    DEFAULT_CSS = """
    ResultScreen { background: $background; }
    ResultScreen #result-title { dock: top; height: 1; background: $panel; }
    ResultScreen #result-words { width: 1fr; height: 1fr; padding: 1 2 0 2; scrollbar-size-vertical: 1; }
    ResultScreen #result-pictures { width: 1fr; height: 1fr; }
    ResultScreen #result-sides { height: 1; padding: 0 2; }
    ResultScreen #result-verdict { height: auto; max-height: 6; padding: 0 2; margin-bottom: 1; }
    ResultScreen #result-caption { height: auto; max-height: 3; padding: 0 2; }
    ResultScreen.-wide #result-words { width: 2fr; min-width: 72; max-width: 84; }
    ResultScreen.-wide #result-pictures { width: 3fr; padding: 1 1 0 0; }
    ResultScreen.-wide #result-verdict { display: none; }
    """

    def __init__(self, job: Job, result: StudyResult) -> None:
        super().__init__()
        self._job, self._result = job, result
        self._at = 0
        self._offset = False
        self._figures = not result.pictures
        self._blinking: Timer | None = None
        self._title = Lines(id="result-title")
        self._verdict = Lines(id="result-verdict")
        self._words = Lines(id="result-figures")
        self._sides = Lines(id="result-sides")
        self._caption = Lines(id="result-caption")
        self._picture = Picture(words="no picture", id="result-picture")
        self._sources: dict[Path, Source] = {}

    def compose(self) -> ComposeResult:
        """Title, words, the picture with its sides above and its caption below, keys."""
        yield self._title
        with Horizontal():
            yield VerticalScroll(self._words, id="result-words")
            with Vertical(id="result-pictures"):
                yield self._verdict
                yield self._sides
                yield self._picture
                yield self._caption
        yield KeyFooter()

    def on_mount(self) -> None:
        """Show it."""
        self._lay_out()

    def on_resize(self) -> None:
        """Side by side where there is room for both."""
        self._lay_out()

    @property
    def shows_offset(self) -> bool:
        """Whether the offset side is seen."""
        return self._offset

    @property
    def picture(self) -> ResultPicture | None:
        """The picture that is seen."""
        return self._result.pictures[self._at] if self._result.pictures else None

    # Doing

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Offer only what this result has."""
        picture = self.picture
        seen = not self._figures or self._is_wide
        return {
            "switch": seen and picture is not None and picture.offset is not None,
            "blink": seen and picture is not None and picture.offset is not None,
            "move": seen and len(self._result.pictures) > 1,
            "figures": bool(self._result.pictures) and not self._is_wide,
            "report": self._result.report is not None,
        }.get(action, True)

    def action_switch(self) -> None:
        """Show the other condition."""
        self._stop_blinking()
        self._turn()

    def action_blink(self) -> None:
        """Show both conditions in turn; the same key ends it."""
        if self._blinking is not None:
            self._stop_blinking()
            self._show_picture()
        else:
            self._blinking = self.set_interval(BLINK_S, self._turn)

    def action_move(self, by: int) -> None:
        """Show another picture, of the same condition."""
        self._at = (self._at + by) % len(self._result.pictures)
        self._show_picture()

    def on_click(self, event: events.Click) -> None:
        """A click on the picture or the sides above it switches, as the key does."""
        clickable = event.widget in (self._picture, self._sides)
        if clickable and self.picture is not None and self.picture.offset is not None:
            self.action_switch()

    def action_figures(self) -> None:
        """Show the figures instead of the pictures, or the pictures again."""
        self._figures = not self._figures
        self._lay_out()

    def action_report(self) -> None:
        """Open the report in the browser."""
        open_report(self, self._result.report)

    def action_close(self) -> None:
        """Go back."""
        self.dismiss(None)

    # Showing

    @property
    def _is_wide(self) -> bool:
        return self.size.width >= WIDE

    def _lay_out(self) -> None:
        self.set_class(self._is_wide, "-wide")
        both = self._is_wide and bool(self._result.pictures)
        self.query_one("#result-words").display = both or self._figures
        self.query_one("#result-pictures").display = both or not self._figures
        if self._figures and not both:
            self.query_one("#result-words").focus()
        self.call_after_refresh(self._show)

    def _show(self) -> None:
        words = self.query_one("#result-words")
        width = max(24, words.scrollable_content_region.width or self.size.width - 4)
        self._title.show(
            [
                Content.assemble(
                    (f" {self._job.kind.title} ", "reverse bold $primary"),
                    (f" {printable(self._job.session.name)}", "bold"),
                    (f"   {printable(str(self._job.out))}", "$foreground-muted"),
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
        self._offset = self._offset and picture.offset is not None
        path = picture.offset if self._offset and picture.offset is not None else picture.synced
        source = self._sources.setdefault(path, partial(_read, path))
        sharp = source if self._blinking is None else None
        self._picture.show(source, f"{path.name} is gone: run the job again", sharp=sharp)
        here, there = ("● ", "○ ") if not self._offset else ("○ ", "● ")
        sides = []
        if picture.offset is not None:
            sides = [
                _side(here + picture.synced_words, not self._offset, "$success"),
                _side(there + picture.offset_words, self._offset, "$error"),
            ]
        place = f"{self._at + 1}/{len(self._result.pictures)}  {printable(picture.title)}"
        line = Content("  ").join(sides)
        gap = self._sides.scrollable_content_region.width - line.cell_length - len(place)
        self._sides.show([Content.assemble(line, " " * max(2, gap), (place, "bold"))])
        width = max(24, self._caption.scrollable_content_region.width)
        self._caption.show(Content.styled(printable(picture.caption), "$foreground-muted").wrap(width)[:3])
        self.refresh_bindings()

    def _turn(self) -> None:
        self._offset = not self._offset
        self._show_picture()

    def _stop_blinking(self) -> None:
        if self._blinking is not None:
            self._blinking.stop()
            self._blinking = None


def open_report(widget: Widget, report: Path | None) -> None:
    """Open a report in the browser; over ssh, where there is none, say where it lies."""
    if report is None or not report.is_file():
        error = BadInputError("the report is gone", hint="run the job again")
        widget.post_message(Mishap(error))
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


def _side(text: str, chosen: bool, style: str) -> Content:
    return Content.styled(f" {text} ", f"reverse bold {style}" if chosen else "$foreground-muted")
