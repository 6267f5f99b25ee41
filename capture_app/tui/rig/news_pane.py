"""What happened at the rig, with the time of the clock, newest at the bottom."""

import textwrap
import time
from collections.abc import Iterable

from textual.containers import VerticalScroll
from textual.content import Content

from capture_app.node.wire.views import NewsLine
from capture_app.text import printable
from capture_app.tui.drawing.lines import Lines

MARKS = {"info": ("·", "$foreground-muted"), "warning": ("!", "$warning"), "error": ("✖", "$error")}
TIME = "%H:%M:%S"
SCROLLBAR = 1
INDENT = 11
"""Cells of the time and the mark."""


def news_lines(news: Iterable[NewsLine], width: int) -> list[Content]:
    """The lines of some news, long ones wrapped."""
    lines: list[Content] = []
    for each in news:
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


class NewsPane(VerticalScroll, can_focus=True):
    """Follows the news unless the user has scrolled back."""

    def __init__(self) -> None:
        super().__init__(id="news")
        self.border_title = "news"
        self._lines = Lines()
        self._shown: tuple[NewsLine, ...] = ()

    def on_mount(self) -> None:
        """Begin at the end."""
        self.mount(self._lines)
        self.anchor()

    def draw(self, news: Iterable[NewsLine]) -> None:
        """Show the news."""
        self._shown = tuple(news)
        self._lines.show(news_lines(self._shown, self.size.width - SCROLLBAR))

    def on_resize(self) -> None:
        """Wrap anew."""
        self.draw(self._shown)
