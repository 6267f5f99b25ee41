"""The tables of a report that hold two conditions beside each other, a row for each measure."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape

from reconstruction.report import wording
from reconstruction.report.cells import COVERAGE, EPIPOLAR, WITHIN, Scores, interval, meter, score_of
from reconstruction.scores.depth_results import StereoComparison
from reconstruction.scores.panorama_results import PanoramaComparison


def pixels(value: float | None) -> str:
    """A length in px."""
    return wording.quantity(value, "px")


@dataclass(frozen=True)
class Measure:
    """A row: the field of the scores that it shows, what it is called and how it is to be read.

    `show` writes a value; shares (`wording.share`) also get a bar.
    """

    key: str
    name: str
    text: str
    show: Callable[[float | None], str] = wording.share
    control: bool = False


CORRECT = (
    Measure(
        "within_2pct",
        WITHIN,
        "Share whose distance is within 2 % of the truth; holes count as wrong. More is better.",
    ),
    Measure("within_1pct", "The same, more strictly", "Within 1 % of the truth."),
    Measure("within_5pct", "The same, less strictly", "Within 5 % of the truth."),
)

_DEPTH = (
    *CORRECT,
    Measure(
        "coverage",
        COVERAGE,
        "Share for which the two pictures agree on a distance; it may still be wrong. More is better.",
    ),
    Measure(
        "epipolar_px",
        EPIPOLAR,
        "A point should lie in the same row of both pictures; this is how far off it is. Less is better.",
        pixels,
    ),
    Measure(
        "photometric",
        "Brightness mismatch",
        "One picture is laid over the other by the distances found; this is how far the brightness differs, "
        "of 255. Less is better.",
        wording.quantity,
    ),
)

_PANORAMA = (
    Measure(
        "mover_flow_p95_px",
        "Misfit of moving things",
        "How far apart both pictures show the same thing; 5 % of what moves is worse. Less is better.",
        pixels,
    ),
    Measure(
        "overlap_flow_p95_px",
        "Misfit in the whole overlap",
        "The same, for everything where the pictures overlap.",
        pixels,
    ),
    Measure(
        "mover_overlap_mad",
        "Brightness difference of moving things",
        "On average, of 255. Less is better.",
        wording.quantity,
    ),
    Measure(
        "static_overlap_mad",
        "Brightness difference of things at rest (control)",
        "On average, of 255; it should not depend on timing.",
        wording.quantity,
        control=True,
    ),
)


def depth_table(stereo: StereoComparison, sides: wording.Sides) -> str:
    """A pair's depth."""
    caption = f"Depth from cameras {stereo.reference} and {stereo.other}"
    return with_control(caption, _DEPTH, stereo.synced, stereo.offset, sides)


def panorama_table(stitch: PanoramaComparison, sides: wording.Sides) -> str:
    """The overlap of a panorama before blending."""
    caption = f"Panorama of cameras {' and '.join(stitch.cameras)}"
    return beside(caption, _PANORAMA, stitch.synced, stitch.offset, sides)


def with_control(
    caption: str, measures: Sequence[Measure], synced: Scores, offset: Scores, sides: wording.Sides
) -> str:
    """Moving things beside the still control, in both conditions; measures nobody took are left out.

    A measure's field is that of its key with `mover_` and `static_` before it.
    """
    both = _heads(sides)
    heads = f"""<tr><td></td><th scope="colgroup" colspan="2">Moving things</th>
<th scope="colgroup" colspan="2">Things at rest (control)</th></tr>
<tr><td></td>{both}{both}</tr>"""
    rows = [
        _row(
            measure,
            [(f"{kind}_{measure.key}", kind == "static") for kind in ("mover", "static")],
            synced,
            offset,
        )
        for measure in measures
    ]
    return _table(caption, heads, rows, columns=4)


def beside(
    caption: str, measures: Sequence[Measure], synced: Scores, offset: Scores, sides: wording.Sides
) -> str:
    """Both conditions; measures nobody took are left out."""
    rows = [_row(measure, [(measure.key, measure.control)], synced, offset) for measure in measures]
    return _table(caption, f"<tr><td></td>{_heads(sides)}</tr>", rows, columns=2)


def _table(caption: str, heads: str, rows: Sequence[str], columns: int) -> str:
    if not any(rows):
        return ""
    return f"""<table class="twin" style="--columns: {columns}">
<caption>{escape(caption)}</caption>
<thead>{heads}</thead>
<tbody>
{"".join(rows)}</tbody></table>"""


def _heads(sides: wording.Sides) -> str:
    return (
        f'<th scope="col" class="synced"><span class="dot"></span>{escape(sides.short)}</th>'
        f'<th scope="col" class="offset"><span class="dot"></span>{escape(sides.late_head)}</th>'
    )


def _row(measure: Measure, fields: Sequence[tuple[str, bool]], synced: Scores, offset: Scores) -> str:
    """The row's cells for each field (and whether it is a control), first synchronized, then offset."""
    cells = []
    for key, control in fields:
        for scores, tone in ((synced, "synced"), (offset, "offset")):
            value = score_of(scores, key)
            bars = measure.show is wording.share
            kind = f"{tone} control" if control else tone
            ranged = interval(scores, key, share=bars)
            shown = f"{escape(measure.show(value))}{meter(value) if bars else ''}{ranged}"
            cells.append((value, f'<td class="{kind}">{shown}</td>'))
    if all(value is None for value, _ in cells):
        return ""
    head = f'<th scope="row">{escape(measure.name)}<small>{escape(wording.tie(measure.text))}</small></th>'
    return f"<tr>{head}{''.join(cell for _, cell in cells)}</tr>\n"
