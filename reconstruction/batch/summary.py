"""The summary of a batch: CSV for spreadsheets, JSON for programs, HTML for people.

Holds no times of day and no durations: the same units give the same bytes.
"""

import csv
from collections.abc import Sequence
from io import StringIO
from pathlib import Path

import msgspec

from capture_app.session.files.durable import write_atomic
from capture_app.text import count, pretty_json
from reconstruction.batch.rows import BatchResult, Group, Row
from reconstruction.batch.thumbnails import depth_sheets
from reconstruction.batch.units import RESULT
from reconstruction.report import tables as report
from reconstruction.report import wording
from reconstruction.report.page import Section, render_page

CSV, JSON, HTML = "summary.csv", "summary.json", "summary.html"
NAMES = (CSV, JSON, HTML)
SHARES = {
    "coverage": "Given a distance",
    "within_2pct": "Measured correctly",
    "mover_within_2pct": "Moving: measured correctly",
    "static_within_2pct": "At rest: measured correctly",
}
FIRST = "Session and condition"


def write_summary(root: Path, result: BatchResult) -> None:
    """Write the three files into the batch's folder."""
    write_atomic(root / JSON, pretty_json({"groups": result.groups, "units": result.units}) + b"\n")
    write_atomic(root / CSV, _csv(result.units).encode())
    write_atomic(root / HTML, _html(root, result).encode())


def _csv(rows: Sequence[Row]) -> str:
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Row.__struct_fields__)
    for row in rows:
        writer.writerow("" if value is None else value for value in msgspec.structs.astuple(row))
    return text.getvalue()


def _html(root: Path, result: BatchResult) -> str:
    """The whole page. Holds no times and no durations."""
    failures = [row for row in result.units if row.problem]
    failed = f", {result.failed} failed" if result.failed else ""
    failed += f", {result.not_applicable} not applicable" if result.not_applicable else ""
    made = len(result.units) - result.failed - result.not_applicable
    verdict = f"{count(made, 'unit')} computed{failed}"
    sections = [Section("problems.html", title="What has no result")] if failures else []
    sheets = depth_sheets(root, result.units)
    pictures = [Section("depth_sheets.html", "depth", title="What was found")] if sheets else []
    return render_page(
        title=f"Batch: {verdict}",
        kicker="Batch of reconstructions",
        name="",
        verdict=f"{verdict}. A unit is depth from all cameras of one instant of a session in one condition.",
        sections=[*sections, *pictures, Section("figures.html")],
        numbers_in=(CSV, JSON),
        package="reconstruction.batch",
        view={
            "failures": failures,
            "sheets": sheets,
            "groups": _table("Medians over the instants", "Instants", list(map(_group, result.groups))),
            "units": _table("Every unit", "Instant", [_unit(row) for row in result.units if not row.problem]),
        },
    )


def _table(caption: str, counted: str, rows: list[report.Row]) -> report.Table:
    heads = (counted, *SHARES.values(), "Median error", "Points in space")
    return report.Table(caption, [report.Column(head) for head in heads], rows, first=FIRST)


def _group(group: Group) -> report.Row:
    notes = [f"{group.failed} failed"] if group.failed else []
    notes += [f"{group.not_applicable} not applicable"] if group.not_applicable else []
    note = ", ".join(notes)
    cells = [report.Cell(f"{group.instants}", note=note), *_figures(group)]
    return report.Row(group.session, cells, details=group.condition)


def _unit(row: Row) -> report.Row:
    cells = [report.Cell(f"{row.instant}"), *_figures(row)]
    return report.Row(row.session, cells, details=row.condition, link=f"{row.folder}/{RESULT}")


def _figures(row: Row | Group) -> list[report.Cell]:
    error = row.median_error_pct
    words = [wording.share(getattr(row, name)) for name in SHARES]
    words.append(wording.NOT_AVAILABLE if error is None else f"{error:.2f}{wording.GAP}%")
    words.append(wording.number(row.fused_points))
    return [report.Cell(text) for text in words]
