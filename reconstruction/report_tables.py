"""The tables of a report that hold synchronized beside offset: depth, and the panorama's overlap."""

from collections.abc import Callable
from html import escape

from reconstruction import wording
from reconstruction.report_cells import COVERAGE, EPIPOLAR, WITHIN, interval, meter, score_of
from reconstruction.results import StereoResult, StitchResult

_Format = Callable[[float | None], str]

_DEPTH_ROWS: tuple[tuple[str, str, str, _Format], ...] = (
    (
        "within_2pct",
        WITHIN,
        "Share whose distance is within 2 % of the truth; holes count as wrong. More is better.",
        wording.share,
    ),
    (
        "coverage",
        COVERAGE,
        "Share for which the two pictures agree on a distance; it may still be wrong. More is better.",
        wording.share,
    ),
    (
        "epipolar_px",
        EPIPOLAR,
        "A point should lie in the same row of both pictures; this is how far off it is. Less is better.",
        lambda value: wording.quantity(value, "px"),
    ),
    (
        "photometric",
        "Brightness mismatch",
        "One picture is laid over the other by the distances found; this is how far the brightness differs, "
        "of 255. Less is better.",
        wording.quantity,
    ),
)


def depth_table(stereo: StereoResult, sides: wording.Sides) -> str:
    """Movers beside the static control, synchronized and offset; measures nobody took are left out."""
    rows = []
    for key, name, text, show in _DEPTH_ROWS:
        moving, resting = (
            [score_of(scores, f"{kind}_{key}") for scores in (stereo.synced, stereo.offset)]
            for kind in ("mover", "static")
        )
        if all(value is None for value in (*moving, *resting)):
            continue
        bars = show is wording.share
        ranges = [
            [interval(scores, f"{kind}_{key}", bars) for scores in (stereo.synced, stereo.offset)]
            for kind in ("mover", "static")
        ]
        rows.append(
            _row(
                name,
                text,
                [(v, show(v), "", bars) for v in moving] + [(v, show(v), "control", bars) for v in resting],
                [*ranges[0], *ranges[1]],
            )
        )
    both = heads(sides)
    return f"""<table class="twin" style="--columns: 4">
<caption>Depth from cameras {escape(stereo.reference)} and {escape(stereo.other)}</caption>
<thead><tr><td></td><th scope="colgroup" colspan="2">Moving things</th>
<th scope="colgroup" colspan="2">Things at rest (control)</th></tr>
<tr><td></td>{both}{both}</tr></thead>
<tbody>
{"".join(rows)}</tbody></table>"""


_PANORAMA_ROWS = (
    (
        "mover_flow_p95_px",
        "Misfit of moving things",
        "How far apart both pictures show the same thing; 5 % of what moves is worse. Less is better.",
        "px",
    ),
    (
        "overlap_flow_p95_px",
        "Misfit in the whole overlap",
        "The same, for everything where the pictures overlap.",
        "px",
    ),
    (
        "mover_overlap_mad",
        "Brightness difference of moving things",
        "On average, of 255. Less is better.",
        "",
    ),
    (
        "static_overlap_mad",
        "Brightness difference of things at rest (control)",
        "On average, of 255; it should not depend on timing.",
        "",
    ),
)


def panorama_table(stitch: StitchResult, sides: wording.Sides) -> str:
    """The overlap of a panorama before blending, synchronized and offset."""
    rows = []
    for key, name, text, unit in _PANORAMA_ROWS:
        values = [score_of(scores, key) for scores in (stitch.synced, stitch.offset)]
        if any(value is not None for value in values):
            kind = "control" if key.startswith("static") else ""
            ranges = [interval(scores, key, share=False) for scores in (stitch.synced, stitch.offset)]
            cells = [(v, wording.quantity(v, unit), kind, False) for v in values]
            rows.append(_row(name, text, cells, ranges))
    return f"""<table class="twin" style="--columns: 2">
<caption>Panorama of cameras {escape(" and ".join(stitch.cameras))}</caption>
<thead><tr><td></td>{heads(sides)}</tr></thead>
<tbody>
{"".join(rows)}</tbody></table>"""


def heads(sides: wording.Sides) -> str:
    """The heads of two columns that stand beside each other."""
    return (
        f'<th scope="col" class="synced"><span class="dot"></span>{escape(sides.short)}</th>'
        f'<th scope="col" class="offset"><span class="dot"></span>{escape(sides.late_head)}</th>'
    )


def _row(name: str, text: str, cells: list[tuple[float | None, str, str, bool]], ranges: list[str]) -> str:
    tones = ("synced", "offset") * 2
    shown = "".join(
        f'<td class="{f"{tone} {kind}".strip()}">{escape(words)}{meter(value) if bar else ""}{ranged}</td>'
        for (value, words, kind, bar), ranged, tone in zip(cells, ranges, tones, strict=False)
    )
    return f'<tr><th scope="row">{escape(name)}<small>{escape(text)}</small></th>{shown}</tr>\n'
