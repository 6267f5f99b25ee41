"""Summary of a batch: CSV for spreadsheets, JSON for programs, HTML with small pictures for people.

It contains no times of day and no durations: equal units give equal bytes.
"""

import csv
from collections.abc import Sequence
from contextlib import suppress
from io import StringIO
from itertools import islice
from pathlib import Path
from statistics import median
from typing import Any

import msgspec
from msgspec import Struct

from capture_app.common.errors import BadInputError, ExitCode
from capture_app.common.grouping import grouped
from capture_app.common.text import count, pretty_json
from capture_app.session.files.durable import write_atomic
from reconstruction.common import wording
from reconstruction.method.truth import DepthShares
from reconstruction.methods.batch.units import RESULT, Unit
from reconstruction.pages.embedding import embed_image
from reconstruction.pages.page import Section, render_page
from reconstruction.report import report_tables as report
from reconstruction.scene.conditions import SYNCED, evenly_spaced

FIGURES = (
    "coverage", "within_2pct", "mover_within_2pct", "static_within_2pct", "median_error_pct", "fused_points",
)  # fmt: skip
MAX_SHEETS = 20
"""Maximum number of sessions with pictures on a page; the tables list all sessions."""
CSV, JSON, HTML = "summary.csv", "summary.json", "summary.html"
NAMES = (CSV, JSON, HTML)
SHARES = {
    "coverage": "Given a distance",
    "within_2pct": "Measured correctly",
    "mover_within_2pct": "Moving: measured correctly",
    "static_within_2pct": "At rest: measured correctly",
}


class UnitRow(Struct, frozen=True, kw_only=True):
    """One unit's results for its reference camera, or the reason why it has none."""

    session: str
    instant: int | None = None
    condition: str = ""
    error: str = ""
    """Why the unit failed."""
    not_applicable: str = ""
    """Why this valid input does not permit depth; not a failure."""
    exit_code: int = ExitCode.OK
    cameras: int | None = None
    coverage: float | None = None
    within_2pct: float | None = None
    mover_within_2pct: float | None = None
    static_within_2pct: float | None = None
    median_error_pct: float | None = None
    fused_points: int | None = None
    folder: str = ""
    picture: str = ""
    """Path of the reference camera's depth as a colour picture."""

    @property
    def label(self) -> str:
        """Name of the unit in a progress line."""
        instant = f"instant {self.instant}" if self.instant is not None else ""
        return ", ".join(filter(None, (self.session, instant, self.condition)))

    @property
    def problem(self) -> str:
        """Reason why the unit has no results, and whether that is a failure; empty if it has results."""
        not_applicable = f"not applicable: {self.not_applicable}" if self.not_applicable else ""
        return f"failed: {self.error}" if self.error else not_applicable


class Group(DepthShares, frozen=True, kw_only=True):
    """Medians over a session's instants in one condition; a value is None if no instant has it."""

    session: str
    condition: str
    instants: int
    failed: int
    not_applicable: int = 0
    coverage: float | None = None
    fused_points: float | None = None


class BatchResult(Struct, frozen=True, kw_only=True):
    """Output of `reconstruct batch --json`; the summary contains its `groups` and `units`."""

    out: str
    computed: int
    """Units computed by this run."""
    reused: int
    """Units whose earlier results were reused."""
    failed: int
    not_applicable: int
    """Units that do not permit depth, even if repeated; their rows say why."""
    groups: tuple[Group, ...]
    units: tuple[UnitRow, ...]
    seconds: float


def unit_row(unit: Unit, **results: Any) -> UnitRow:
    """Return a unit's row with these values."""
    return UnitRow(session=unit.name, instant=unit.instant, condition=unit.condition, **results)


def completed_row(unit: Unit, root: Path) -> UnitRow:
    """Return the row of a unit with a result."""
    record = msgspec.json.decode((root / unit.folder / RESULT).read_bytes())
    views = record.get("views", ())
    picture = next((view["picture"] for view in views if view["camera"] == record["reference"]), "")
    return unit_row(
        unit,
        not_applicable=record.get("not_applicable", ""),
        cameras=len(views) or None,
        folder=unit.folder,
        picture=f"{unit.folder}/{picture}" if picture else "",
        **{name: record.get(name) for name in FIGURES},
    )


def judged_rows(rows: Sequence[UnitRow]) -> list[UnitRow]:
    """Mark other conditions of an instant as not applicable if its synchronized images are.

    Depth of offset images is meaningless where synchronized images give none.
    """
    refused = {
        (row.session, row.instant): row.not_applicable
        for row in rows
        if row.condition == SYNCED and row.not_applicable
    }
    return [
        UnitRow(
            session=row.session,
            instant=row.instant,
            condition=row.condition,
            not_applicable=f"nor are synchronized pictures: {reason}",
        )
        if row.condition != SYNCED and (reason := refused.get((row.session, row.instant)))
        else row
        for row in rows
    ]


def group_medians(rows: Sequence[UnitRow]) -> tuple[Group, ...]:
    """Return one group for each session and condition that has a unit, in the rows' order."""
    groups = []
    units = grouped(((row.session, row.condition), row) for row in rows if row.condition)
    for (session, condition), ours in units.items():
        known = {name: [v for row in ours if (v := getattr(row, name)) is not None] for name in FIGURES}
        groups.append(
            Group(
                session=session,
                condition=condition,
                instants=sum(not row.problem for row in ours),
                failed=sum(bool(row.error) for row in ours),
                not_applicable=sum(bool(row.not_applicable) for row in ours),
                **{name: round(median(values), 4) if values else None for name, values in known.items()},
            )
        )
    return tuple(groups)


def depth_sheets(root: Path, rows: Sequence[UnitRow]) -> list[dict[str, Any]]:
    """Return a sheet of small depth pictures for each `session` that has any, at most `MAX_SHEETS`.

    Each sheet's `rows` has an entry for each condition, with a picture or None for each of the `instants`.
    """
    pictured = grouped(
        (row.session, ((row.condition, row.instant), row.picture))
        for row in rows
        if row.picture and row.instant is not None
    )
    sheets = []
    for session, ours in islice(pictured.items(), MAX_SHEETS):
        pictures = dict(ours)
        # More do not fit a page.
        instants = evenly_spaced(sorted({instant for _, instant in pictures}), 12)
        shown = [
            (condition, [_thumbnail(root, pictures.get((condition, instant), "")) for instant in instants])
            for condition in dict.fromkeys(condition for condition, _ in pictures)
        ]
        sheets.append({"session": session, "instants": instants, "rows": shown})
    return sheets


def _thumbnail(root: Path, path: str) -> dict[str, object] | None:
    """Return a small picture as `embed_image` packs it, and the `path` of the original beside the page.

    None also if the picture was deleted or damaged since: the figures remain valid.
    """
    with suppress(BadInputError):
        return {"path": path, **embed_image(root / path, max_px=160)} if path else None
    return None


def write_summary(root: Path, result: BatchResult) -> None:
    """Write the three files into the batch's folder."""
    write_atomic(root / JSON, pretty_json({"groups": result.groups, "units": result.units}) + b"\n")
    table = StringIO()
    rows = map(msgspec.structs.astuple, result.units)
    csv.writer(table, lineterminator="\n").writerows([UnitRow.__struct_fields__, *rows])
    write_atomic(root / CSV, table.getvalue().encode())
    write_atomic(root / HTML, _html(root, result).encode())


def _html(root: Path, result: BatchResult) -> str:
    """Return the whole page, without times and durations."""
    failures = [row for row in result.units if row.problem]
    verdict = ", ".join([f"{count(len(result.units) - len(failures), 'unit')} computed", *_unmade(result)])
    sections = [Section("problems.html", title="What has no result")] if failures else []
    sheets = depth_sheets(root, result.units)
    sections += [Section("depth_sheets.html", "depth", title="What was found")] if sheets else []
    view = {
        "title": f"Batch: {verdict}",
        "kicker": "Batch of reconstructions",
        "name": "",
        "verdict": f"{verdict}. A unit is depth from all cameras of one instant of a session in one "
        "condition.",
        "numbers_in": (CSV, JSON),
        "failures": failures,
        "sheets": sheets,
        "groups": _table(
            "Medians over the instants",
            "Instants",
            [_row(group, f"{group.instants}", note=", ".join(_unmade(group))) for group in result.groups],
        ),
        "units": _table(
            "Every unit",
            "Instant",
            [
                _row(unit, f"{unit.instant}", link=f"{unit.folder}/{RESULT}")
                for unit in result.units
                if not unit.problem
            ],
        ),
    }
    return render_page(view, [*sections, Section("figures.html")], __package__)


def _unmade(made: BatchResult | Group) -> list[str]:
    """Return the numbers of units without a result in words; empty if there are none."""
    numbers = {"failed": made.failed, "not applicable": made.not_applicable}
    return [f"{number} {word}" for word, number in numbers.items() if number]


def _table(caption: str, counted: str, rows: list[report.Row]) -> report.Table:
    heads = (counted, *SHARES.values(), "Median error", "Points in space")
    return report.Table(caption, list(map(report.Column, heads)), rows, first="Session and condition")


def _row(row: UnitRow | Group, counted: str, *, note: str = "", link: str = "") -> report.Row:
    error = row.median_error_pct
    words = (
        *(wording.percentage(getattr(row, name)) for name in SHARES),
        wording.NOT_AVAILABLE if error is None else f"{error:.2f}{wording.GAP}%",
        wording.number(row.fused_points),
    )
    return report.Row(
        row.session,
        [report.Cell(counted, note=note), *map(report.Cell, words)],
        details=row.condition,
        link=link,
    )
