"""The tolerance curve's section of a report, and the page of `reconstruct tolerance`."""

from pathlib import Path

from reconstruction.common import wording
from reconstruction.method.comparison_results import OffsetTolerance
from reconstruction.method.score import study_reports
from reconstruction.method.spoken import spoken
from reconstruction.method.words import StudyText
from reconstruction.pages.page import Section, render_page, write_page
from reconstruction.report.findings import sentences
from reconstruction.report.report_tables import Cell, Column, Row, Table, interval_cell

COLUMNS = {
    "mover_within_2pct": "Measured correctly",
    "mover_coverage": "Given a distance",
    "mover_epipolar_px": "Vertical mismatch",
    "static_coverage": "At rest: given a distance",
}


def tolerance_view(tolerance: OffsetTolerance) -> dict[str, object]:
    """Return what a page shows of a tolerance curve: the curve, a sentence, and the numbers."""
    return {
        "found": tolerance,
        "sentence": tolerance_sentence(tolerance),
        "table": _table(tolerance),
        "instants": _instants(tolerance),
    }


def tolerance_sentence(tolerance: OffsetTolerance) -> str:
    """Return the curve's result in a few sentences; images are called synchronized only if found so."""
    best = max(tolerance.points, key=lambda point: point.value(tolerance.measure, "offset") or 0.0)
    return sentences("tolerance.txt", curve=tolerance, best=best, lenses=tolerance.lenses.doubt())


def tolerance_heading(tolerance: OffsetTolerance) -> str:
    """Return the heading; a tolerated delay is claimed only if the images without delay show one instant."""
    known = tolerance.timing is not None and tolerance.timing.synchronized
    return "Delay that this motion tolerates" if known else "Depth against delay"


def _text(tolerance: OffsetTolerance) -> StudyText:
    """Return the text of the study that measured the curve's points."""
    return study_reports()[tolerance.points[0].name].text


def _table(tolerance: OffsetTolerance) -> Table:
    columns = {key: name for key, name in COLUMNS.items() if key != "mover_within_2pct" or tolerance.right}
    rows = [
        Row(
            wording.milliseconds(round(point.late_ms or 0.0, 1)),
            [interval_cell(point.interval(key, "offset"), _text(tolerance).unit(key)) for key in columns],
        )
        for point in tolerance.points
    ]
    return Table(
        "Moving things by delay; small print: 95 % intervals",
        list(map(Column, columns.values())),
        rows,
        first="Delay",
    )


def _instants(tolerance: OffsetTolerance) -> Table:
    """Return a row for each instant: the second camera's time offset by motion, and the instant's curve."""
    texts = (
        {moment.instant: moment for moment in tolerance.timing.instants}
        if tolerance.timing is not None
        else {}
    )
    known = {row.instant: row for row in tolerance.per_instant}
    rows = []
    for instant in sorted(texts.keys() | known.keys()):
        late, curve = texts.get(instant), known.get(instant)
        values = curve.values if curve is not None else (None,) * len(tolerance.points)
        cells = (
            wording.number(None if curve is None else curve.mover_pixels),
            wording.NOT_AVAILABLE if late is None else f"{late.late_ms:+.1f} ± {2 * late.sd_ms:.1f} ms",
            *(wording.percentage(value, decimals=0) for value in values),
        )
        rows.append(Row(f"{instant}", list(map(Cell, cells))))
    delays = (wording.milliseconds(round(point.late_ms or 0.0)) for point in tolerance.points)
    return Table(
        "Each instant: the second picture's time offset by moving points, and the part of what moves that is "
        f"{'right' if tolerance.right else 'found'} at each delay",
        list(map(Column, ("Moving pixels", "Time offset", *delays))),
        rows,
        first="Instant",
        prefix="Instant ",
    )


def write_tolerance_report(result: OffsetTolerance, out: Path) -> Path:
    """Write the curve's own page into the folder `out`; see `write_page`."""
    name, result = Path(result.session).name or result.session, spoken(result, result.labels)
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
