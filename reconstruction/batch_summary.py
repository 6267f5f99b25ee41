"""What a batch made, as a table: CSV for spreadsheets, JSON for programs, HTML for people.

Holds no times of day and no durations: the same units give the same bytes, whenever they were made.
"""

import csv
from collections.abc import Sequence
from html import escape
from io import StringIO
from pathlib import Path
from statistics import median

import msgspec
from msgspec import Struct

from capture_app.errors import ExitCode
from capture_app.session.durable import write_whole
from reconstruction.unit_plan import RESULT, Failure
from reconstruction.units import Unit

CSV, JSON, HTML = "summary.csv", "summary.json", "summary.html"
NAMES = (CSV, JSON, HTML)
FIGURES = (
    "coverage", "within_2pct", "mover_within_2pct", "static_within_2pct", "median_error_pct", "fused_points",
)  # fmt: skip
HEADINGS = (
    "depth, share of pixels", "within 2 %", "movers within 2 %", "static within 2 %", "median error, %",
    "fused points",
)  # fmt: skip


class Row(Struct, frozen=True, kw_only=True):
    """A unit and the figures of its reference camera; those with an error in them need ground truth."""

    session: str
    instant: int | None
    condition: str
    problem: str = ""
    code: int = ExitCode.OK
    cameras: int | None = None
    coverage: float | None = None
    within_2pct: float | None = None
    mover_within_2pct: float | None = None
    static_within_2pct: float | None = None
    median_error_pct: float | None = None
    fused_points: int | None = None
    folder: str = ""


class Group(Struct, frozen=True, kw_only=True):
    """Medians over a session's instants in one condition; None where no instant has the figure."""

    session: str
    condition: str
    instants: int
    failed: int
    coverage: float | None = None
    within_2pct: float | None = None
    mover_within_2pct: float | None = None
    static_within_2pct: float | None = None
    median_error_pct: float | None = None
    fused_points: float | None = None


class BatchResult(Struct, frozen=True, kw_only=True):
    """What `reconstruct batch --json` prints; the summary holds its `groups` and `units`."""

    out: str
    made: int
    """Units that this run made."""
    there: int
    """Units that were there already."""
    failed: int
    groups: tuple[Group, ...]
    units: tuple[Row, ...]
    seconds: float


class _UnitFile(Struct, frozen=True, kw_only=True):
    """What is read of a unit.json."""

    views: tuple[dict[str, object], ...] = ()
    coverage: float | None = None
    within_2pct: float | None = None
    mover_within_2pct: float | None = None
    static_within_2pct: float | None = None
    median_error_pct: float | None = None
    fused_points: int | None = None


def unit_row(unit: Unit, root: Path) -> Row:
    """The row of a unit that is there."""
    told = msgspec.json.decode((root / unit.folder / RESULT).read_bytes(), type=_UnitFile)
    return Row(
        session=unit.name,
        instant=unit.instant,
        condition=unit.condition,
        cameras=len(told.views),
        folder=unit.folder,
        **{name: getattr(told, name) for name in FIGURES},
    )


def failed_row(failure: Failure) -> Row:
    """The row of what is not there, and why."""
    return Row(
        session=failure.name,
        instant=failure.instant,
        condition=failure.condition,
        problem=failure.problem,
        code=failure.code,
    )


def summarize(rows: Sequence[Row]) -> tuple[Group, ...]:
    """One group for each session and condition that has a unit, in the rows' order."""
    groups = []
    for session, condition in dict.fromkeys((row.session, row.condition) for row in rows if row.condition):
        ours = [row for row in rows if (row.session, row.condition) == (session, condition)]
        figures = {}
        for name in FIGURES:
            values = [value for row in ours if (value := getattr(row, name)) is not None]
            figures[name] = round(median(values), 4) if values else None
        failed = sum(bool(row.problem) for row in ours)
        groups.append(
            Group(session=session, condition=condition, instants=len(ours) - failed, failed=failed, **figures)
        )
    return tuple(groups)


def write_summary(root: Path, result: BatchResult) -> None:
    """Write the three files into the batch's folder."""
    told = {"groups": result.groups, "units": result.units}
    write_whole(root / JSON, msgspec.json.format(msgspec.json.encode(told), indent=2) + b"\n")
    write_whole(root / CSV, _csv(result.units).encode())
    write_whole(root / HTML, _html(result).encode())


def _csv(rows: Sequence[Row]) -> str:
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Row.__struct_fields__)
    for row in rows:
        writer.writerow("" if value is None else value for value in msgspec.structs.astuple(row))
    return text.getvalue()


def _html(result: BatchResult) -> str:
    groups = [
        [group.session, group.condition, _count(group), *(_figure(getattr(group, n)) for n in FIGURES)]
        for group in result.groups
    ]
    units = [
        [
            _link(row), "" if row.instant is None else str(row.instant), escape(row.condition),
            *([_figure(getattr(row, n)) for n in FIGURES] if not row.problem else [escape(row.problem)]),
        ]
        for row in result.units
    ]  # fmt: skip
    done = len(result.units) - result.failed
    failed = f", {result.failed} failed" if result.failed else ""
    return PAGE.format(
        verdict=f"{done} units made{failed}",
        groups=_table(
            ("session", "condition", "instants", *HEADINGS), [[*map(escape, row)] for row in groups]
        ),
        units=_table(("session", "instant", "condition", *HEADINGS), units),
    )


def _count(group: Group) -> str:
    return str(group.instants) + (f" ({group.failed} failed)" if group.failed else "")


def _link(row: Row) -> str:
    name = escape(row.session)
    return f'<a href="{escape(row.folder)}/{RESULT}">{name}</a>' if row.folder else name


def _figure(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.0f}" if value >= 100 else f"{value:.4g}"


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th scope=col>{heading}</th>" for heading in headings)
    body = []
    for row in rows:
        cells = [f"<td>{cell}</td>" for cell in row]
        if len(row) < len(headings):
            cells[-1] = f"<td class=bad colspan={len(headings) - len(row) + 1}>{row[-1]}</td>"
        body.append(f"<tr>{''.join(cells)}</tr>\n")
    return f"<div><table><thead><tr>{head}</tr></thead>\n<tbody>\n{''.join(body)}</tbody></table></div>"


PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>Batch of reconstructions</title>
<style>
:root {{ color-scheme: light dark; font: 1rem/1.5 system-ui, sans-serif; }}
body {{ max-width: 70rem; margin: 0 auto; padding: 2rem 1rem; }}
div {{ overflow-x: auto; }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; }}
th, td {{ text-align: left; vertical-align: top; padding: .3rem .8rem .3rem 0; }}
th, td {{ border-bottom: 1px solid #8886; }}
.bad {{ color: light-dark(#a33a00, #ff9c57); }}
</style></head><body>
<h1>{verdict}</h1>
<p>Figures are of each instant's reference camera; shares are of 1. &ldquo;Within 2 %&rdquo; counts
pixels without depth as wrong, and needs the true depth.</p>
<h2>Medians over the instants</h2>
{groups}
<h2>Every unit</h2>
{units}
</body></html>
"""
