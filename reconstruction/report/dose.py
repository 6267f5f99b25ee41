"""The dose curve's part of a report, and the report of `reconstruct dose` alone."""

from html import escape
from pathlib import Path

from capture_app.session.files.durable import write_whole
from reconstruction.report import wording
from reconstruction.report.cells import COVERAGE, EPIPOLAR, STILL_COVERAGE, WITHIN, Head, listing
from reconstruction.report.dose_plot import dose_plot
from reconstruction.report.frame import fill_page
from reconstruction.report.verdict import together
from reconstruction.scores.dose_results import DoseResult
from reconstruction.scores.results import Interval

REPORT = "report.html"


def dose_sentence(dose: DoseResult) -> str:
    """What a user takes away from the curve."""
    late = dose.points[-1]
    first, last = (getattr(p.scores, dose.measure) for p in (dose.points[0], late))
    what = "the right distance is found" if dose.measure.endswith("2pct") else "a distance is found"
    if not together(dose.points[0].scores):
        return (
            f"These cameras were not synchronized: as recorded, {what} for "
            f"{wording.share(first, decimals=0)} of what moves, so that more lateness changes little."
        )
    start = (
        f"Synchronized, {what} for {wording.share(first, decimals=0)} of what moves; "
        f"{wording.lateness(late.offset_ms)}, for {wording.share(last, decimals=0)}."
    )
    if dose.bearable_ms is None:
        return f"{start} No lateness up to that costs a tenth of it."
    return f"{start} This motion bears about {_time(dose.bearable_ms)} of lateness."


def dose_section(dose: DoseResult | None) -> str:
    """The curve with its words and numbers; nothing where there is none."""
    if dose is None:
        return ""
    return f"""<section aria-labelledby="dose">
<h2 id="dose">How much lateness this motion bears</h2>
<p>{escape(dose_sentence(dose))}</p>
{_curve(dose)}
</section>"""


def _curve(dose: DoseResult) -> str:
    notes = [
        "The solid line is what moves, the dashed one what stands still: the control. Shaded: where the "
        f"value lies with 95 % confidence, from {wording.count(dose.instants, 'instant')}."
    ]
    if dose.bearable_ms is not None and together(dose.points[0].scores):
        notes.append(
            "What it bears: until a tenth of what was found is lost, or half of what moves has gone a pixel, "
            "whichever comes first."
        )
    if dose.speed_px_per_ms:
        notes.append(
            f"Half of what moves goes farther than {wording.quantity(dose.speed_px_per_ms, 'pixels')} "
            "in a millisecond in the picture."
        )
    if dose.own_error_us is None:
        notes.append("This session keeps no record of its own error.")
    else:
        moved = ""
        if dose.own_error_px is not None:
            small = dose.own_error_px < 0.01
            far = wording.quantity(0.01 if small else dose.own_error_px, "px")
            moved = f", in which it moves {'less than ' if small else ''}{far}"
        error = wording.microseconds(dose.own_error_us)
        notes.append(f"This session's own largest error is {error}{moved}.")
    words = "".join(f"<p>{escape(wording.tie(note))}</p>" for note in notes)
    return f"""<div class="curve">{dose_plot(dose)}
<div>{words}</div></div>
{_table(dose)}"""


def write_dose_report(result: DoseResult, out: Path) -> Path:
    """Write the page of the curve alone into the folder `out`."""
    name = Path(result.session).name or result.session
    entries = {
        "Session": result.session,
        "Depth": f"cameras {result.reference} and {result.other}, "
        f"{wording.count(result.instants, 'instant')} (taken for {wording.tie(result.why)})",
        "Calibration": result.calibration,
        "Software": ", ".join(f"{key} {value}" for key, value in result.versions.items()),
    }
    making = "".join(f"<dt>{escape(key)}</dt><dd>{escape(words)}</dd>" for key, words in entries.items())
    page = fill_page(
        title=f"{name}: how much lateness its motion bears",
        kicker="Depth against lateness",
        name=name,
        verdict=dose_sentence(result),
        sections=[
            f'<section aria-label="The curve">{_curve(result)}</section>',
            f'<section aria-labelledby="making"><h2 id="making">How it was made</h2>'
            f'<dl class="making">{making}</dl></section>',
        ],
    )
    target = out / REPORT
    write_whole(target, page.encode("utf-8", "replace"))
    return target


def _time(value_ms: float) -> str:
    return wording.microseconds(value_ms * 1000) if value_ms < 1 else wording.milliseconds(round(value_ms, 1))


def _table(dose: DoseResult) -> str:
    true = dose.measure == "mover_within_2pct"
    rows = []
    for point in dose.points:
        scores = point.scores
        cells = [_ranged(scores.mover_within_2pct, scores.intervals.get("mover_within_2pct"))] if true else []
        cells += [
            _ranged(scores.mover_coverage, scores.intervals.get("mover_coverage")),
            wording.quantity(scores.mover_epipolar_px, "px"),
            wording.share(scores.static_coverage),
        ]
        rows.append([escape(wording.milliseconds(round(point.offset_ms, 1))), *cells])
    names = ["Late by", *([WITHIN] if true else []), COVERAGE, EPIPOLAR, STILL_COVERAGE]
    return listing("By lateness, moving things; small: 95 % intervals", [Head(name) for name in names], rows)


def _ranged(value: float | None, found: Interval | None) -> str:
    text = escape(wording.share(value))
    if found is None or value is None:
        return text
    return f"{text}<small>{100 * found.low:.1f} to {100 * found.high:.1f}</small>"
