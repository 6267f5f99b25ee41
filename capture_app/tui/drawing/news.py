"""Lines of news with the time of the clock and a mark for how bad they are."""

import textwrap
import time
from collections.abc import Iterable

from textual.content import Content

from capture_app.node.wire.views import NewsLine
from capture_app.text import printable

MARKS = {"info": ("·", "$foreground-muted"), "warning": ("!", "$warning"), "error": ("✖", "$error")}
TIME = "%H:%M:%S"
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
