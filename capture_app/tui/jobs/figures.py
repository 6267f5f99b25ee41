"""A result in words: verdict and tables as lines of the screen."""

import re

from textual.content import Content

from capture_app.text import printable
from capture_app.tui.jobs.results import ResultTable, StudyResult


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
