"""Results of a batch as rows, one for each unit, and their medians."""

from collections.abc import Sequence
from pathlib import Path
from statistics import median

import msgspec
from msgspec import Struct

from capture_app.common.errors import ExitCode
from reconstruction.batch.units import RESULT, Unit
from reconstruction.scores.truth import DepthShares
from reconstruction.session.conditions import SYNCED

FIGURES = (
    "coverage", "within_2pct", "mover_within_2pct", "static_within_2pct", "median_error_pct", "fused_points",
)  # fmt: skip


class Row(Struct, frozen=True, kw_only=True):
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
    def problem(self) -> str:
        """Reason why the unit has no results, and whether that is a failure; empty if it has results."""
        if self.error:
            return f"failed: {self.error}"
        return f"not applicable: {self.not_applicable}" if self.not_applicable else ""


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
    units: tuple[Row, ...]
    seconds: float


def completed_row(unit: Unit, root: Path) -> Row:
    """Return the row of a unit with a result."""
    record = msgspec.json.decode((root / unit.folder / RESULT).read_bytes())
    views = record.get("views", ())
    picture = next((one["picture"] for one in views if one["camera"] == record["reference"]), "")
    return Row(
        session=unit.name,
        instant=unit.instant,
        condition=unit.condition,
        not_applicable=record.get("not_applicable", ""),
        cameras=len(views) or None,
        folder=unit.folder,
        picture=f"{unit.folder}/{picture}" if picture else "",
        **{name: record.get(name) for name in FIGURES},
    )


def judged_rows(rows: Sequence[Row]) -> list[Row]:
    """Mark other conditions of an instant as not applicable if its synchronized images are.

    Depth of offset images is meaningless where synchronized images give none.
    """
    refused = {
        (row.session, row.instant): row.not_applicable
        for row in rows
        if row.condition == SYNCED and row.not_applicable
    }
    return [
        Row(
            session=row.session,
            instant=row.instant,
            condition=row.condition,
            not_applicable=f"nor are synchronized pictures: {reason}",
        )
        if row.condition != SYNCED and (reason := refused.get((row.session, row.instant)))
        else row
        for row in rows
    ]


def group_medians(rows: Sequence[Row]) -> tuple[Group, ...]:
    """Return one group for each session and condition that has a unit, in the rows' order."""
    groups = []
    for session, condition in dict.fromkeys((row.session, row.condition) for row in rows if row.condition):
        ours = [row for row in rows if (row.session, row.condition) == (session, condition)]
        figures = {}
        for name in FIGURES:
            values = [value for row in ours if (value := getattr(row, name)) is not None]
            figures[name] = round(median(values), 4) if values else None
        failed = sum(bool(row.error) for row in ours)
        not_applicable = sum(bool(row.not_applicable) for row in ours)
        groups.append(
            Group(
                session=session,
                condition=condition,
                instants=len(ours) - failed - not_applicable,
                failed=failed,
                not_applicable=not_applicable,
                **figures,
            )
        )
    return tuple(groups)
