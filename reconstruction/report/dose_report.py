"""The dose curve's part of a report, and the report of `reconstruct dose` alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from capture_app.text import count
from reconstruction.report import wording
from reconstruction.report.charts import DoseChart, dose_chart
from reconstruction.report.measures import COVERAGE, EPIPOLAR, STILL_COVERAGE, WITHIN, pixels
from reconstruction.report.page import Section, render_page, write_page
from reconstruction.report.provenance import Entry
from reconstruction.report.tables import Column, Row, Table, score_cell
from reconstruction.report.verdict import plausibly_synchronized
from reconstruction.scores.results import DoseResult

COLUMNS = (
    ("mover_within_2pct", WITHIN, wording.share),
    ("mover_coverage", COVERAGE, wording.share),
    ("mover_epipolar_px", EPIPOLAR, pixels),
    ("static_coverage", STILL_COVERAGE, wording.share),
)


@dataclass(frozen=True)
class DoseView:
    """The curve, what it says, and its numbers."""

    sentence: str
    notes: Sequence[str]
    chart: DoseChart
    table: Table


def dose_view(dose: DoseResult) -> DoseView:
    """What a page shows of a dose curve."""
    return DoseView(dose_sentence(dose), _notes(dose), dose_chart(dose), _table(dose))


def dose_sentence(dose: DoseResult) -> str:
    """The result of the curve in a sentence or two."""
    late = dose.points[-1]
    first, last = (getattr(p.scores, dose.measure) for p in (dose.points[0], late))
    what = "the right distance is found" if dose.measure.endswith("2pct") else "a distance is found"
    if not plausibly_synchronized(dose.points[0].scores):
        return (
            f"These cameras were not synchronized: as recorded, {what} for "
            f"{wording.share(first, decimals=0)} of what moves, so that a further delay changes little."
        )
    start = (
        f"Synchronized, {what} for {wording.share(first, decimals=0)} of what moves; "
        f"{wording.lateness(late.offset_ms)}, for {wording.share(last, decimals=0)}."
    )
    if dose.tolerable_offset_ms is None:
        return f"{start} Up to that delay, less than a tenth of it is lost."
    return f"{start} This motion tolerates a delay of about {_time(dose.tolerable_offset_ms)}."


def _notes(dose: DoseResult) -> list[str]:
    notes = [
        "The solid line shows what moves, the dashed one what stands still (the control). Shaded: 95 % "
        f"confidence intervals from {count(dose.instants, 'instant')}."
    ]
    if dose.tolerable_offset_ms is not None and plausibly_synchronized(dose.points[0].scores):
        notes.append(
            "Tolerated is the delay at which a tenth of what was found is lost, or half of the moving pixels "
            "have moved by one pixel, whichever comes first."
        )
    if dose.speed_px_per_ms:
        notes.append(
            "Half of the moving pixels are faster than "
            f"{wording.quantity(dose.speed_px_per_ms, 'pixels')} per millisecond."
        )
    if dose.sync_residual_us is None:
        notes.append("This session has no record of its synchronization error.")
    else:
        moved = ""
        if dose.sync_residual_px is not None:
            small = dose.sync_residual_px < 0.01
            far = wording.quantity(0.01 if small else dose.sync_residual_px, "px")
            moved = f", in which the motion covers {'less than ' if small else ''}{far}"
        error = wording.microseconds(dose.sync_residual_us)
        notes.append(f"The largest synchronization error of this session is {error}{moved}.")
    return notes


def _table(dose: DoseResult) -> Table:
    columns = [one for one in COLUMNS if one[1] != WITHIN or dose.measure == "mover_within_2pct"]
    rows = [
        Row(
            wording.milliseconds(round(point.offset_ms, 1)),
            [score_cell(point.scores, key, show) for key, _, show in columns],
        )
        for point in dose.points
    ]
    return Table(
        "Moving things by delay; small print: 95 % intervals",
        [Column(name) for _, name, _ in columns],
        rows,
        first="Delay",
    )


def write_dose_report(result: DoseResult, out: Path) -> Path:
    """Write the page of the curve alone into the folder `out`, as `write_page` does."""
    name = Path(result.session).name or result.session
    cameras = f"cameras {result.reference} and {result.other}"
    instants = count(result.instants, "instant")
    page = render_page(
        title=f"{name}: how much delay its motion tolerates",
        kicker="Depth against delay",
        name=name,
        verdict=dose_sentence(result),
        sections=[Section("dose_alone.html"), Section("provenance.html", "provenance", "How it was made")],
        view={
            "dose": dose_view(result),
            "provenance": [
                Entry("Session", result.session),
                Entry("Depth", f"{cameras}, {instants} (selection: {result.reason})"),
                Entry("Calibration", result.calibration),
                Entry("Software", ", ".join(f"{key} {value}" for key, value in result.versions.items())),
            ],
            "files": [],
        },
    )
    return write_page(page, out)


def _time(value_ms: float) -> str:
    return wording.microseconds(value_ms * 1000) if value_ms < 1 else wording.milliseconds(round(value_ms, 1))
