"""The tolerance curve's section of a report, and the page of `reconstruct tolerance`."""

from pathlib import Path

from reconstruction.report import wording
from reconstruction.report.charts import tolerance_chart
from reconstruction.report.findings import motion_sentence, timing_sentences
from reconstruction.report.page import Section, render_page, write_page
from reconstruction.report.report_tables import Cell, Column, Row, Table, interval_cell
from reconstruction.report.study_report import (
    COVERAGE,
    EPIPOLAR,
    STILL_COVERAGE,
    WITHIN,
    StudyText,
    study_reports,
)
from reconstruction.scores.comparison_results import DelayFacts, OffsetTolerance
from reconstruction.scores.study_result import StudyResult

COLUMNS = {
    "mover_within_2pct": WITHIN,
    "mover_coverage": COVERAGE,
    "mover_epipolar_px": EPIPOLAR,
    "static_coverage": STILL_COVERAGE,
}


def tolerance_view(tolerance: OffsetTolerance) -> dict[str, object]:
    """Return what a page shows of a tolerance curve: the chart, a sentence, and the numbers."""
    return {
        "found": tolerance,
        "sentence": tolerance_sentence(tolerance),
        "chart": tolerance_chart(tolerance),
        "table": _table(tolerance),
        "instants": _instants(tolerance),
    }


def tolerance_sentence(tolerance: OffsetTolerance) -> str:
    """Return the curve's result in a few sentences; images are called synchronized only if found so."""
    timing = tolerance.timing
    if timing is None:
        return f"As recorded, {_found_in_both_directions(tolerance)}"
    texts = [f"As recorded, {_found_in_both_directions(tolerance)}", timing_sentences(timing)]
    if timing.synchronized:
        found = f"Synchronized, {_found_in_both_directions(tolerance)} {_tolerated(tolerance)}"
        texts = [found, timing_sentences(timing)]
    elif timing.offset:
        texts = [timing_sentences(timing), f"As recorded, {_found_at_best(tolerance)}"]
    return " ".join(text for text in (motion_sentence(timing), *texts) if text)


def tolerance_heading(tolerance: OffsetTolerance) -> str:
    """Return the heading; a tolerated delay is claimed only if the images without delay show one instant."""
    known = tolerance.timing is not None and tolerance.timing.synchronized
    return "Delay that this motion tolerates" if known else "Depth against delay"


def _found_in_both_directions(tolerance: OffsetTolerance) -> str:
    ends = {ms: point for point in (tolerance.points[0], tolerance.points[-1]) if (ms := point.late_ms)}
    directions = [
        f"{wording.offset_text(ms)}, for {_found_fraction(tolerance, point)}" for ms, point in ends.items()
    ]
    first = f"{_what(tolerance)} for {_found_fraction(tolerance, tolerance.as_recorded)} of what moves"
    return f"{first}; with the second picture {'; '.join(directions)}." if directions else f"{first}."


def _found_at_best(tolerance: OffsetTolerance) -> str:
    text = f"{_what(tolerance)} for {_found_fraction(tolerance, tolerance.as_recorded)} of what moves"
    best = max(tolerance.points, key=lambda point: point.value(tolerance.measure, "offset") or 0.0)
    if not best.late_ms:
        return f"{text}."
    when = wording.offset_text(best.late_ms)
    return f"{text}; best with the second picture {when}, for {_found_fraction(tolerance, best)}."


def _tolerated(tolerance: OffsetTolerance) -> str:
    tolerated_ms = tolerance.tolerable_offset_ms
    if tolerated_ms is None:
        return "Up to that delay, less than a tenth of it is lost."
    tolerated = (
        wording.milliseconds(round(tolerated_ms, 1))
        if tolerated_ms >= 1
        else wording.microseconds(1000 * tolerated_ms)
    )
    return f"This motion tolerates a delay of about {tolerated}."


def _what(tolerance: OffsetTolerance) -> str:
    return "the right distance is found" if tolerance.measure.endswith("2pct") else "a distance is found"


def _text(tolerance: OffsetTolerance) -> StudyText:
    """Return the text of the study that measured the curve's points."""
    return study_reports()[tolerance.points[0].name].text


def _found_fraction(tolerance: OffsetTolerance, point: StudyResult[DelayFacts]) -> str:
    return wording.percentage(point.value(tolerance.measure, "offset"), decimals=0)


def _table(tolerance: OffsetTolerance) -> Table:
    true = tolerance.measure == "mover_within_2pct"
    columns = {key: name for key, name in COLUMNS.items() if true or name != WITHIN}
    rows = [
        Row(
            wording.milliseconds(round(point.late_ms or 0.0, 1)),
            [interval_cell(point.interval(key, "offset"), _text(tolerance).unit(key)) for key in columns],
        )
        for point in tolerance.points
    ]
    heads = [Column(name) for name in columns.values()]
    return Table("Moving things by delay; small print: 95 % intervals", heads, rows, first="Delay")


def _instants(tolerance: OffsetTolerance) -> Table:
    """Return a row for each instant: the second camera's time offset by motion, and the instant's curve."""
    texts = {one.instant: one for one in tolerance.timing.instants} if tolerance.timing is not None else {}
    known = {one.instant: one for one in tolerance.per_instant}
    rows = []
    for instant in sorted(texts.keys() | known.keys()):
        late, curve = texts.get(instant), known.get(instant)
        values = curve.values if curve is not None else (None,) * len(tolerance.points)
        cells = [
            Cell(wording.number(None if curve is None else curve.mover_pixels)),
            Cell(wording.NOT_AVAILABLE if late is None else f"{late.late_ms:+.1f} ± {2 * late.sd_ms:.1f} ms"),
            *(Cell(wording.percentage(value, decimals=0)) for value in values),
        ]
        rows.append(Row(f"{instant}", cells))
    right = tolerance.measure == "mover_within_2pct"
    heads = [wording.milliseconds(round(point.late_ms or 0.0)) for point in tolerance.points]
    columns = [Column("Moving pixels"), Column("Time offset"), *(Column(head) for head in heads)]
    return Table(
        "Each instant: the second picture's time offset by moving points, and the part of what moves that is "
        f"{'right' if right else 'found'} at each delay",
        columns,
        rows,
        first="Instant",
        prefix="Instant ",
    )


def write_tolerance_report(result: OffsetTolerance, out: Path) -> Path:
    """Write the curve's own page into the folder `out`; see `write_page`."""
    name = Path(result.session).name or result.session
    view = {
        "title": f"{name}: {tolerance_heading(result).lower()}",
        "kicker": "Depth against delay",
        "name": name,
        "verdict": tolerance_sentence(result),
        "result": result,
        "tolerance": tolerance_view(result),
        "engine": _text(result).engine,
    }
    return write_page(render_page(view, [Section("tolerance_alone.html")]), out)
