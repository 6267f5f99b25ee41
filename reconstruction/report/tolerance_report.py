"""The dose curve's part of a report, and the report of `reconstruct dose` alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from capture_app.text import count
from reconstruction.report import wording
from reconstruction.report.charts import DoseChart, dose_chart
from reconstruction.report.findings import instant_lateness, motion_sentence, timing_sentences
from reconstruction.report.measures import COVERAGE, EPIPOLAR, STILL_COVERAGE, WITHIN, pixels
from reconstruction.report.page import Section, render_page, write_page
from reconstruction.report.provenance import Entry
from reconstruction.report.tables import Cell, Column, Row, Table, score_cell
from reconstruction.scores.comparison_results import DoseResult
from reconstruction.scores.study_result import DepthScores

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
    instants: Table


def dose_view(dose: DoseResult) -> DoseView:
    """What a page shows of a dose curve."""
    return DoseView(dose_sentence(dose), _notes(dose), dose_chart(dose), _table(dose), _instants(dose))


def dose_sentence(dose: DoseResult) -> str:
    """The result of the curve in a few sentences: synchronized is said only where that was found."""
    timing = dose.timing
    moved = [motion_sentence(timing)] if timing is not None and timing.moving_cameras else []
    told = [timing_sentences(timing)] if timing is not None else []
    if timing is not None and timing.synchronized:
        return " ".join([*moved, f"Synchronized, {_found_to_both_sides(dose)}", _tolerance(dose), *told])
    if timing is not None and timing.offset:
        return " ".join([*moved, *told, f"As recorded, {_found_at_best(dose)}"])
    return " ".join([*moved, f"As recorded, {_found_to_both_sides(dose)}", *told])


def dose_heading(dose: DoseResult) -> str:
    """What a motion tolerates is known only where the pictures of no delay are of one instant."""
    known = dose.timing is not None and dose.timing.synchronized
    return "How much delay this motion tolerates" if known else "Depth against delay"


def _found_to_both_sides(dose: DoseResult) -> str:
    ends = {point.offset_ms: point for point in (dose.points[0], dose.points[-1]) if point.offset_frames}
    sides = [f"{wording.lateness(ms)}, for {_share(dose, point.scores)}" for ms, point in ends.items()]
    first = f"{_what(dose)} for {_share(dose, dose.as_recorded)} of what moves"
    return f"{first}; with the second picture {'; '.join(sides)}." if sides else f"{first}."


def _found_at_best(dose: DoseResult) -> str:
    text = f"{_what(dose)} for {_share(dose, dose.as_recorded)} of what moves"
    best = max(dose.points, key=lambda point: getattr(point.scores, dose.measure) or 0.0)
    if not best.offset_frames:
        return f"{text}."
    when = wording.lateness(best.offset_ms)
    return f"{text}; best with the second picture {when}, for {_share(dose, best.scores)}."


def _tolerance(dose: DoseResult) -> str:
    if dose.tolerable_offset_ms is None:
        return "Up to that delay, less than a tenth of it is lost."
    return f"This motion tolerates a delay of about {_time(dose.tolerable_offset_ms)}."


def _what(dose: DoseResult) -> str:
    return "the right distance is found" if dose.measure.endswith("2pct") else "a distance is found"


def _share(dose: DoseResult, scores: DepthScores) -> str:
    return wording.share(getattr(scores, dose.measure), decimals=0)


def _notes(dose: DoseResult) -> list[str]:
    shaky = dose.timing is not None and bool(dose.timing.moving_cameras)
    notes = [
        "The solid line shows what moves, the dashed one what stands still"
        f"{'' if shaky else ' (the control)'}. Shaded: 95 % "
        f"confidence intervals over {count(dose.instants, 'instant')}; every point is the median over the "
        "instants. To the left of zero the second picture is early."
    ]
    if dose.tolerable_offset_ms is not None:
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


def _instants(dose: DoseResult) -> Table:
    """Every instant by itself: how late its moving points say the second picture is, and its own curve."""
    told = {one.instant: one for one in dose.timing.instants} if dose.timing is not None else {}
    known = {one.instant: one for one in dose.per_instant}
    rows = []
    for instant in sorted(told.keys() | known.keys()):
        late, curve = told.get(instant), known.get(instant)
        values = curve.values if curve is not None else (None,) * len(dose.points)
        cells = [
            Cell(wording.number(None if curve is None else curve.mover_pixels)),
            Cell(wording.NOT_AVAILABLE if late is None else instant_lateness(late.late_ms, late.sd_ms)),
            *(Cell(wording.share(value, decimals=0)) for value in values),
        ]
        rows.append(Row(f"{instant}", cells))
    right = dose.measure == "mover_within_2pct"
    heads = [wording.milliseconds(round(point.offset_ms)) for point in dose.points]
    columns = [Column("Moving pixels"), Column("Lateness"), *(Column(head) for head in heads)]
    return Table(
        "Each instant: how late its moving points say the second picture is, and how much of what moves is "
        f"{'right' if right else 'found'} with that picture so much later",
        columns,
        rows,
        first="Instant",
        prefix="Instant ",
    )


def write_dose_report(result: DoseResult, out: Path) -> Path:
    """Write the page of the curve alone into the folder `out`, as `write_page` does."""
    name = Path(result.session).name or result.session
    cameras = f"cameras {result.reference} and {result.other}"
    instants = count(result.instants, "instant")
    page = render_page(
        title=f"{name}: {dose_heading(result).lower()}",
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
