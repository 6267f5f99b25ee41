"""The tables of a report that list: all conditions, and every instant by itself."""

from collections.abc import Callable
from html import escape

from reconstruction import wording
from reconstruction.report_cells import interval, score_of
from reconstruction.results import CompareResult, ConditionResult, DepthScores, StereoResult, StitchScores


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
        ranged = interval(scores, key, share=show is wording.share)
        cells.append(f"<td>{escape(show(score_of(scores, key)))}{ranged}</td>")
    small = f"<small>{escape(details)}</small>" if details else ""
    return f'<tr><th scope="row">{escape(name)}{small}</th>{"".join(cells)}</tr>'


_INSTANT_COLUMNS: tuple[tuple[str, str, Callable[[float | None], str]], ...] = (
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
