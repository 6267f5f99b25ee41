"""Lines of text on the screen that send only changed cells to the terminal."""

import textwrap
import time
from collections.abc import Iterable, Sequence
from itertools import groupby
from operator import itemgetter

from rich.segment import Segment
from textual.content import Content
from textual.geometry import Offset, Region, Size
from textual.strip import Strip
from textual.widget import Widget

from capture_app.common.text import printable
from capture_app.protocol.status import LogLine

MARKS = {"info": ("·", "$foreground-muted"), "warning": ("!", "$warning"), "error": ("✖", "$error")}
TIME = "%H:%M:%S"
INDENT = 11
"""Cells of the time and the mark."""


def strip_of_line(widget: Widget, line: Content) -> Strip:
    """Return a styled line as a widget's strip for the terminal."""
    parse = widget.app.stylesheet.parse_style
    rendered = line.render(widget.visual_style, end="", parse_style=lambda style: parse(str(style)))
    return Strip(Segment(text, style.rich_style) for text, style in rendered)


def justified(left: Content, right: Content, width: int) -> Content:
    """Return a line of a width, `left` at its start, truncated if needed, and `right` at its end."""
    left = left.truncate(max(0, width - right.cell_length - bool(right.cell_length)), ellipsis=True)
    return Content.assemble(left, " " * max(0, width - left.cell_length - right.cell_length), right)


def fitting(parts: Iterable[Content], gap: str, width: int) -> list[Content]:
    """Return the parts that fit in a line, earlier ones first."""
    fit: list[Content] = []
    for part in parts:
        if sum(one.cell_length + len(gap) for one in fit) + part.cell_length <= width:
            fit.append(part)
    return fit


def chosen_line(line: Content, width: int) -> Content:
    """Return a selected line: a mark in its first cell, and a background over the whole width."""
    line = Content.assemble(("▌", "$primary"), line[1:])
    return line.pad_right(max(width - line.cell_length, 0)).stylize_before("on $block-cursor-background")


def filled_cells(fraction: float, width: int) -> str:
    """Return a bar of a fraction of `width` cells, in steps of an eighth of a cell."""
    eighths = round(8 * width * min(max(fraction, 0.0), 1.0))
    return "█" * (eighths // 8) + ("▏▎▍▌▋▊▉"[eighths % 8 - 1] if eighths % 8 else "")


def bar_rows(eighths: Sequence[int], height: int) -> list[str]:
    """Return bars with these heights in eighths of a cell, as rows of text from top to bottom."""
    return [
        "".join(" ▁▂▃▄▅▆▇█"[min(max(each - 8 * row, 0), 8)] for each in eighths)
        for row in range(height - 1, -1, -1)
    ]


def joined_cells(cells: Iterable[tuple[str, str]]) -> Content:
    """Join cells with styles into a line."""
    return Content.assemble(
        *(("".join(cell for cell, _ in run), style) for style, run in groupby(cells, key=itemgetter(1)))
    )


def write_border(widget: Widget, title: Content | str | None, subtitle: Content | str | None = None) -> None:
    """Show these words in a widget's border, and redraw no more than them; None leaves those shown."""
    for place, words in (("_border_title", title), ("_border_subtitle", subtitle)):
        if words is not None and str(words) != str(getattr(widget, place)):
            # Setting Textual's own attribute draws all in the widget again.
            setattr(widget, place, words if isinstance(words, Content) else Content(words))
            line = Region(0, 0, *widget.outer_size.with_height(1))
            at = 0 if place == "_border_title" else widget.outer_size.height - 1
            widget.refresh(line.translate(Offset(0, at) - widget.content_offset))


class Lines(Widget):
    """Widget of styled lines, truncated with an ellipsis; its auto height is the number of lines."""

    DEFAULT_CSS = "Lines { height: auto; }"

    def __init__(self, *, id: str | None = None, classes: str | None = None) -> None:
        super().__init__(id=id, classes=classes)
        self._lines: tuple[Content, ...] = ()
        self._strips: list[Strip | None] = []
        """The lines as drawn; None for one that has not been seen yet in these colours."""

    @property
    def plain(self) -> tuple[str, ...]:
        """Lines without style."""
        return tuple(line.plain for line in self._lines)

    def show(self, lines: Iterable[Content]) -> None:
        """Replace the lines, and redraw the cells that differ."""
        before, old = self._strips, self._lines
        self._lines = tuple(lines)
        self._strips = [None] * len(self._lines)
        if not self.is_attached:
            return
        if len(before) != len(self._lines) or (
            self.styles.is_auto_width and _width(old) != _width(self._lines)
        ):
            self.refresh(layout=True)
            # A layout already in progress would discard this one.
            self.call_after_refresh(self.refresh, layout=True)
            return
        now = [strip_of_line(self, line) for line in self._lines]
        spans = [changed_cells(one or Strip(()), new) for one, new in zip(before, now, strict=True)]
        self._strips = [*now]
        if regions := [Region(begin, y, end - begin, 1) for y, (begin, end) in enumerate(spans) if end]:
            self.refresh(*regions)

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:
        """Return the number of lines."""
        return len(self._lines)

    def get_content_width(self, container: Size, viewport: Size) -> int:
        """Return the width of the widest line."""
        return _width(self._lines)

    def render_line(self, y: int) -> Strip:
        """Return the line in the present colours."""
        if y >= len(self._strips):
            return Strip.blank(self.size.width, self.rich_style)
        if (strip := self._strips[y]) is None:
            strip = self._strips[y] = strip_of_line(self, self._lines[y])
        width = self.size.width
        if strip.cell_length > width > 1 and strip.text[width - 1 :].strip():
            cropped = strip.crop(0, width - 1)
            strip = Strip([*cropped, Segment("…", list(cropped)[-1].style)])
        return strip.adjust_cell_length(width, self.rich_style)

    def notify_style_update(self) -> None:
        """Redraw in the new colours."""
        super().notify_style_update()
        self._strips = [None] * len(self._lines)
        self.refresh()


def _width(lines: Iterable[Content]) -> int:
    return max((line.cell_length for line in lines), default=0)


def changed_cells(old: Strip, new: Strip) -> tuple[int, int]:
    """Return the first differing cell and the last + 1; both are 0 if all are equal."""
    if old == new:
        return 0, 0
    before, after = ([(each, style) for text, style, _ in strip for each in text] for strip in (old, new))
    # A wide character is one entry for two cells: strips with one differ as a whole.
    if not len(before) == len(after) == old.cell_length == new.cell_length:
        return 0, max(old.cell_length, new.cell_length, 1)
    differing = [x for x, (one, other) in enumerate(zip(before, after, strict=True)) if one != other]
    return (differing[0], differing[-1] + 1) if differing else (0, 0)


def log_lines(log: Iterable[LogLine], width: int) -> list[Content]:
    """Return the lines of log entries, long ones wrapped."""
    lines: list[Content] = []
    for each in log:
        mark, style = MARKS[each.level]
        clock = time.strftime(TIME, time.localtime(each.unix_ns / 1e9))
        text_style = "" if each.level == "info" else style
        wrapped = textwrap.wrap(printable(each.text), max(width - INDENT, 10)) or [""]
        lines.append(
            Content.assemble(
                (f"{clock} ", "$foreground-muted"), (f"{mark} ", f"bold {style}"), (wrapped[0], text_style)
            )
        )
        lines += [Content.styled(" " * INDENT + line, text_style) for line in wrapped[1:]]
    return lines
