"""The tables of a report that list: all conditions, and every instant by itself."""

from collections.abc import Callable
from html import escape

from reconstruction import wording
from reconstruction.report_cells import (
    COVERAGE,
    EPIPOLAR,
    STILL_COVERAGE,
    WITHIN,
    Head,
    interval,
    listing,
    score_of,
)
from reconstruction.results import CompareResult, ConditionResult, DepthScores, StereoResult, StitchScores

_Show = Callable[[float | None], str]
_Row = tuple[str, str, DepthScores | None, StitchScores | None]


def _pixels(value: float | None) -> str:
    return wording.quantity(value, "px")


_COLUMNS: tuple[tuple[str, str, _Show], ...] = (
    ("mover_within_2pct", WITHIN, wording.share),
    ("mover_coverage", COVERAGE, wording.share),
    ("static_coverage", STILL_COVERAGE, wording.share),
    ("overlap_flow_p95_px", "Panorama's misfit", _pixels),
)


def conditions_table(result: CompareResult) -> str:
    """All conditions by a few measures, with intervals; nothing where there are no further ones."""
    if not result.conditions:
        return ""
    stereo, stitch = result.stereo, result.stitch
    sides = wording.sides(stereo.synced if stereo else None, result.actual_offset_ms)
    rows: list[_Row] = [
        (sides.first.lower(), "", stereo.synced if stereo else None, stitch.synced if stitch else None),
        (
            sides.late,
            "one camera of each pair",
            stereo.offset if stereo else None,
            stitch.offset if stitch else None,
        ),
    ]
    rows += [
        (
            f"session {one.name}" if one.session else one.name,
            _details(one),
            one.stereo.offset if one.stereo else None,
            one.stitch.offset if one.stitch else None,
        )
        for one in result.conditions
    ]
    columns = [column for column in _COLUMNS if any(_value(row, column[0]) is not None for row in rows)]
    if not columns:
        return ""
    return listing(
        "All conditions, moving things",
        [Head("Condition"), *(Head(name) for _, name, _ in columns)],
        [_condition_row(row, columns) for row in rows],
    )


def _details(one: ConditionResult) -> str:
    late = (("depth", one.stereo_offset_ms), ("panorama", one.stitch_offset_ms))
    parts = [f"{what}: {wording.lateness(ms)}" for what, ms in late if ms is not None]
    if one.session:
        parts.append("other pictures, not paired by instant")
    return "; ".join([*parts, *one.skipped])


def _scores(row: _Row, key: str) -> DepthScores | StitchScores | None:
    return row[3] if key.startswith("overlap") else row[2]


def _value(row: _Row, key: str) -> float | None:
    scores = _scores(row, key)
    return None if scores is None else score_of(scores, key)


def _condition_row(row: _Row, columns: list[tuple[str, str, _Show]]) -> list[str]:
    name, details = row[:2]
    cells = [escape(name) + (f"<small>{escape(details)}</small>" if details else "")]
    for key, _, show in columns:
        scores = _scores(row, key)
        ranged = interval(scores, key, share=show is wording.share) if scores else ""
        cells.append(f"{escape(show(_value(row, key)))}{ranged}")
    return cells


_INSTANT_COLUMNS: tuple[tuple[str, str, _Show], ...] = (
    ("mover_within_2pct", WITHIN, wording.share),
    ("mover_coverage", COVERAGE, wording.share),
    ("mover_epipolar_px", EPIPOLAR, _pixels),
)


def instants_table(stereo: StereoResult, names: wording.Sides) -> str:
    """Every instant's numbers on moving things, synchronized and offset, folded away."""
    columns = [
        column
        for column in _INSTANT_COLUMNS
        if any(row.get(f"synced_{column[0]}") is not None for row in stereo.per_instant)
    ]
    if not columns:
        return ""
    sides = (("synced", names.short), ("offset", "Late"))
    heads = [Head("Instant"), Head("Moving pixels")]
    heads += [Head(side, group=name, tone=tone) for _, name, _ in columns for tone, side in sides]
    rows = [
        [
            f'<span class="narrow">Instant </span>{row["instant"]}',
            str(row["mover_pixels"]),
            *(escape(show(row.get(f"{tone}_{key}"))) for key, _, show in columns for tone, _ in sides),
        ]
        for row in stereo.per_instant
    ]
    table = listing(f"Moving things, cameras {stereo.reference} and {stereo.other}", heads, rows)
    return f"<details><summary>Every instant by itself</summary>\n{table}</details>\n"
