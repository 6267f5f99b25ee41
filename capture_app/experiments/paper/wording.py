"""How the page and its Markdown word numbers, units and set-ups."""

import re

from capture_app.experiments.paper.applications import Measure
from capture_app.experiments.paper.report import Entry, PaperReport, Row, SetUp
from capture_app.text import count

TITLE = "The paper's tables and figures, and ours"
LEAD = (
    "Ansari, Wadhwa, Garg and Chen, Wireless Software Synchronization of Multiple Distributed Cameras (ICCP "
    "2019), measured with real phones. Every number of ours on this page is simulated: the engine is the one "
    "that runs in the program, but its cameras, clocks, links and LED panels are models."
)
KEY = (
    "✓ ours at the paper's protocol is at most the paper's; ✗ it is larger; = the paper's number went into "
    "the model, so that agreeing shows nothing. No sign: neither way is better."
)
HEAD = ("", "paper", "ours, its protocol", "ours, default")
APPLICATIONS_LEAD = (
    "Made by other commands of sessions that come with the project, rendered by its simulator (simulated). "
    "The paper shows them as pictures, without numbers."
)
CONDITIONS = {"synced": "synchronized", "offset": "some time apart"}
NOTHING = "–"
UNITS = {"us": "µs", "degrees": "°"}
SIGNS = {"better": "✓", "worse": "✗", "put in": "=", "": ""}


def number(value: float | None, unit: str, *, digits: int | None = None) -> str:
    """Write a number with its unit, to three figures or so many digits after the point."""
    if value is None:
        return NOTHING
    if digits is None:
        digits = 0 if abs(value) >= 100 or value == round(value) else 1 if abs(value) >= 10 else 2
    text = f"{value:,.{digits}f}"
    return f"{text}\N{NO-BREAK SPACE}{UNITS.get(unit, unit)}" if unit else text


def papers(row: Row) -> str:
    """Write the paper's number, as the paper does."""
    if row.paper is None:
        return NOTHING
    text = number(row.paper, row.unit, digits=len(f"{row.paper:.6g}".partition(".")[2]))
    return f"≤\N{NO-BREAK SPACE}{text}" if row.paper_at_most else text


def ours(row: Row) -> str:
    """Write ours at the paper's protocol."""
    return number(row.protocol, row.unit)


def sign(row: Row) -> str:
    """Return what stands beside ours at the paper's protocol: how it compares, if it does."""
    return SIGNS[row.verdict]


def by_default(row: Row) -> str:
    """Write ours by default."""
    return number(row.default, row.unit)


def condition(measure: Measure, name: str) -> str:
    """Write an application's number in a condition, `synced` or `offset`."""
    return number(getattr(measure, name), measure.unit)


def set_ups(entry: Entry) -> tuple[str, ...]:
    """Say how both of ours were measured."""
    if entry.default == entry.protocol:
        return (f"Ours, at the paper's protocol and by default: {_set_up(entry.protocol)}",)
    return (
        f"Ours at the paper's protocol: {_set_up(entry.protocol)}",
        f"Ours by default: {_set_up(entry.default)}",
    )


def _set_up(one: SetUp) -> str:
    return f"{in_print(one.setup)} ({one.kind}, {count(one.trials, 'trial')})."


def in_print(text: str) -> str:
    """Return a text with its units as they are printed."""
    return re.sub(r"(?<=\d) us\b", "\N{NO-BREAK SPACE}µs", text)


def measured(report: PaperReport) -> str:
    """Say how the report came about."""
    quick = " --quick" if report.quick else ""
    return f"Made by `capture-app experiment paper{quick}`, seed {report.seed}; trials stand with each."


def headlines(report: PaperReport) -> list[tuple[Entry, Row]]:
    """Return the numbers for the top of the page, each with what it is of."""
    entries = (*report.tables, *report.figures)
    return [(entry, row) for entry in entries for row in entry.rows if row.headline]
