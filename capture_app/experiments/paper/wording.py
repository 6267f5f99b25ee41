"""How the page and its Markdown word numbers, units and set-ups."""

import re

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
NOTHING = "–"
UNITS = {"us": "µs"}
SIGNS = {"better": "✓", "worse": "✗", "put in": "=", "": ""}


def number(value: float | None, unit: str) -> str:
    """Write a number with its unit, to three figures."""
    if value is None:
        return NOTHING
    if abs(value) >= 100 or value == round(value):
        text = f"{value:,.0f}"
    else:
        text = f"{value:.1f}" if abs(value) >= 10 else f"{value:.2f}"
    return f"{text}\N{NO-BREAK SPACE}{UNITS.get(unit, unit)}" if unit else text


def papers(row: Row) -> str:
    """Write the paper's number."""
    text = number(row.paper, row.unit)
    return f"≤\N{NO-BREAK SPACE}{text}" if row.paper_at_most and row.paper is not None else text


def ours(row: Row) -> str:
    """Write ours at the paper's protocol, with its sign."""
    return f"{number(row.protocol, row.unit)} {SIGNS[row.verdict]}".strip()


def by_default(row: Row) -> str:
    """Write ours by default."""
    return number(row.default, row.unit)


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
    fewer = " with a tenth of the trials (`--quick`)" if report.quick else ""
    return f"Made by `capture-app experiment paper`{fewer}, seed {report.seed}."


def headlines(report: PaperReport) -> list[tuple[Entry, Row]]:
    """Return the numbers for the top of the page, each with the table that it is of."""
    return [(entry, row) for entry in report.tables for row in entry.rows if row.headline]
