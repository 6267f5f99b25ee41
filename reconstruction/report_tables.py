"""The numbers of a report: two large ones, and the tables that back them."""

import math
from collections.abc import Callable
from html import escape

from reconstruction import wording
from reconstruction.results import (
    CompareResult,
    ConditionResult,
    DepthScores,
    StereoResult,
    StitchResult,
    StitchScores,
)

_Format = Callable[[float | None], str]


def claims(result: CompareResult) -> str:
    """Two numbers, synchronized and offset, that say it all; nothing where there are none."""
    late = wording.lateness(result.actual_offset_ms)
    stereo, stitch = result.stereo, result.stitch
    note = ""
    shown: tuple[tuple[str, str, float | None], ...]
    if stereo and None not in (stereo.synced.mover_within_2pct, stereo.offset.mover_within_2pct):
        what = "of the moving surface measured correctly"
        shown = _shares(stereo.synced.mover_within_2pct, stereo.offset.mover_within_2pct, what)
    elif stereo and None not in (stereo.synced.mover_coverage, stereo.offset.mover_coverage):
        what = "of the moving surface given a distance"
        note = "Nobody knows the true distances here, so this counts where the two pictures agree on one."
        shown = _shares(stereo.synced.mover_coverage, stereo.offset.mover_coverage, what)
    elif stitch:
        pair = (stitch.synced.mover_flow_p95_px, stitch.offset.mover_flow_p95_px)
        words = "of misfit of moving things where the pictures of the panorama overlap"
        if None in pair:
            pair = (stitch.synced.overlap_flow_p95_px, stitch.offset.overlap_flow_p95_px)
            words = "of misfit where the pictures of the panorama overlap"
        most = max(1e-9, *(value for value in pair if value is not None))
        shown = tuple((wording.quantity(v, "px"), words, None if v is None else v / most) for v in pair)
    else:
        return ""
    whens = ("when both pictures show the same instant", f"when one picture is {late}")
    sides = zip(("synced", "offset"), shown, whens, strict=True)
    cards = '<div class="claims">' + "".join(_claim(*side) for side in sides) + "</div>"
    return cards + (f'<p class="quiet">{note}</p>' if note else "")


def _shares(
    synced: float | None, offset: float | None, what: str
) -> tuple[tuple[str, str, float | None], ...]:
    return tuple((wording.share(value, decimals=0), what, value) for value in (synced, offset))


def _claim(side: str, shown: tuple[str, str, float | None], when: str) -> str:
    value, what, fraction = shown
    return (
        f'<p class="claim {side}"><strong>{escape(value)}</strong>{_meter(fraction)} {escape(what)} '
        f'<span class="which">{escape(when)}</span></p>'
    )


def _meter(fraction: float | None) -> str:
    if fraction is None or math.isnan(fraction):
        return ""
    return f'<span class="meter" style="--share: {min(max(fraction, 0.0), 1.0):.4f}"></span>'


_DEPTH_ROWS: tuple[tuple[str, str, str, _Format], ...] = (
    (
        "within_2pct",
        "Measured correctly",
        "Share whose distance is within 2 % of the truth; holes count as wrong. More is better.",
        wording.share,
    ),
    (
        "coverage",
        "Given a distance",
        "Share for which the two pictures agree on a distance; it may still be wrong. More is better.",
        wording.share,
    ),
    (
        "epipolar_px",
        "Up-and-down mismatch",
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


def depth_table(stereo: StereoResult, offset_ms: float) -> str:
    """Movers beside the static control, synchronized and offset; measures nobody took are left out."""
    rows = []
    for key, name, text, show in _DEPTH_ROWS:
        moving, resting = (
            [_score(scores, f"{kind}_{key}") for scores in (stereo.synced, stereo.offset)]
            for kind in ("mover", "static")
        )
        if all(value is None for value in (*moving, *resting)):
            continue
        bars = show is wording.share
        ranges = [
            [_range(scores, f"{kind}_{key}", bars) for scores in (stereo.synced, stereo.offset)]
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
    heads = _heads(offset_ms)
    return f"""<table style="--columns: 4">
<caption>Depth from cameras {escape(stereo.reference)} and {escape(stereo.other)}</caption>
<thead><tr><td></td><th scope="colgroup" colspan="2">Moving things</th>
<th scope="colgroup" colspan="2">Things at rest (control)</th></tr>
<tr><td></td>{heads}{heads}</tr></thead>
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


def panorama_table(stitch: StitchResult, offset_ms: float) -> str:
    """The overlap of a panorama before blending, synchronized and offset."""
    rows = []
    for key, name, text, unit in _PANORAMA_ROWS:
        values = [_score(scores, key) for scores in (stitch.synced, stitch.offset)]
        if any(value is not None for value in values):
            kind = "control" if key.startswith("static") else ""
            ranges = [_range(scores, key, share=False) for scores in (stitch.synced, stitch.offset)]
            cells = [(v, wording.quantity(v, unit), kind, False) for v in values]
            rows.append(_row(name, text, cells, ranges))
    return f"""<table style="--columns: 2">
<caption>Panorama of cameras {escape(" and ".join(stitch.cameras))}</caption>
<thead><tr><td></td>{_heads(offset_ms)}</tr></thead>
<tbody>
{"".join(rows)}</tbody></table>"""


def _score(scores: DepthScores | StitchScores, name: str) -> float | None:
    value: float | None = getattr(scores, name)
    return value


def _heads(offset_ms: float) -> str:
    late = wording.lateness(offset_ms)
    late = late[0].upper() + late[1:]
    return (
        '<th scope="col" class="synced"><span class="dot"></span>Synced</th>'
        f'<th scope="col" class="offset"><span class="dot"></span>{escape(late)}</th>'
    )


def _range(scores: DepthScores | StitchScores, name: str, share: bool) -> str:
    """The 95 % interval over the instants, small; empty where there is none."""
    found = scores.intervals.get(name)
    if found is None:
        return ""
    low, high = (
        (f"{100 * value:.0f}" if share else wording.quantity(value)) for value in (found.low, found.high)
    )
    return f'<small title="95 % interval over the instants">{low} to {high}</small>'


def _row(name: str, text: str, cells: list[tuple[float | None, str, str, bool]], ranges: list[str]) -> str:
    tones = ("synced", "offset") * 2
    shown = "".join(
        f'<td class="{f"{tone} {kind}".strip()}">{escape(words)}{_meter(value) if bar else ""}{ranged}</td>'
        for (value, words, kind, bar), ranged, tone in zip(cells, ranges, tones, strict=False)
    )
    return f'<tr><th scope="row">{escape(name)}<small>{escape(text)}</small></th>{shown}</tr>\n'


_INSTANT_COLUMNS: tuple[tuple[str, str, _Format], ...] = (
    ("mover_within_2pct", "Right within 2 %", wording.share),
    ("mover_coverage", "Given a distance", wording.share),
    ("mover_epipolar_px", "Between rows", lambda value: wording.quantity(value, "px")),
)


def instants_table(stereo: StereoResult) -> str:
    """Every instant's numbers on moving things, synchronized and offset, folded away."""
    columns = [
        column
        for column in _INSTANT_COLUMNS
        if any(row.get(f"synced_{column[0]}") is not None for row in stereo.per_instant)
    ]
    if not columns:
        return ""
    heads = "".join(f'<th scope="colgroup" colspan="2">{name}</th>' for _, name, _ in columns)
    sides = '<th scope="col" class="synced">synced</th><th scope="col" class="offset">late</th>'
    rows = []
    for row in stereo.per_instant:
        cells = "".join(
            f"<td>{escape(show(row.get(f'{condition}_{key}')))}</td>"
            for key, _, show in columns
            for condition in ("synced", "offset")
        )
        rows.append(f"<tr><td>{row['instant']}</td><td>{row['mover_pixels']}</td>{cells}</tr>")
    return f"""<details><summary>Every instant by itself</summary>
<div class="wide"><table>
<thead><tr><td></td><td></td>{heads}</tr>
<tr><th scope="col">Instant</th><th scope="col">Moving pixels</th>{sides * len(columns)}</tr></thead>
<tbody>
{"".join(rows)}</tbody></table></div></details>
"""


def conditions_table(result: CompareResult) -> str:
    """All conditions by a few measures, with intervals; nothing where there are no further ones."""
    if not result.conditions:
        return ""
    rows = [
        _condition_row(
            "synchronized",
            result.stereo.synced if result.stereo else None,
            result.stitch.synced if result.stitch else None,
            "",
        ),
        _condition_row(
            wording.lateness(result.actual_offset_ms),
            result.stereo.offset if result.stereo else None,
            result.stitch.offset if result.stitch else None,
            "",
        ),
    ]
    for one in result.conditions:
        rows.append(
            _condition_row(
                f"session {one.name}" if one.session else one.name,
                one.stereo.offset if one.stereo else None,
                one.stitch.offset if one.stitch else None,
                _details(one),
            )
        )
    heads = "".join(
        f'<th scope="col">{name}</th>'
        for name in (
            "Condition",
            "Right within 2 %",
            "Given a distance",
            "At rest, given one",
            "Panorama misfit",
        )
    )
    return f"""<div class="wide"><table><caption>All conditions, moving things</caption>
<thead><tr>{heads}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>"""


def _details(one: ConditionResult) -> str:
    late = (("depth", one.stereo_offset_ms), ("panorama", one.stitch_offset_ms))
    parts = [f"{what}: {wording.lateness(ms)}" for what, ms in late if ms is not None]
    return "; ".join([*parts, *one.skipped])


def _condition_row(name: str, depth: DepthScores | None, panorama: StitchScores | None, details: str) -> str:
    cells = []
    for key, scores, show in (
        ("mover_within_2pct", depth, wording.share),
        ("mover_coverage", depth, wording.share),
        ("static_coverage", depth, wording.share),
        ("overlap_flow_p95_px", panorama, lambda value: wording.quantity(value, "px")),
    ):
        if scores is None:
            cells.append("<td>n/a</td>")
            continue
        ranged = _range(scores, key, share=show is wording.share)
        cells.append(f"<td>{escape(show(_score(scores, key)))}{ranged}</td>")
    small = f"<small>{escape(details)}</small>" if details else ""
    return f'<tr><th scope="row">{escape(name)}{small}</th>{"".join(cells)}</tr>'
