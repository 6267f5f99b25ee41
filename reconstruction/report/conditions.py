"""The tables of a report that list: all conditions, and every instant by itself."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape

from reconstruction.report import wording
from reconstruction.report.cells import (
    COVERAGE,
    EPIPOLAR,
    STILL_COVERAGE,
    WITHIN,
    Head,
    Scores,
    interval,
    listing,
    score_of,
)
from reconstruction.report.tables import pixels
from reconstruction.scores.compare_results import CompareResult, ConditionResult
from reconstruction.scores.depth_results import StereoComparison

_Show = Callable[[float | None], str]


@dataclass(frozen=True)
class _Row:
    """A condition: its name, what is to be said of it, and its scores by the part that took them."""

    name: str
    details: str
    parts: dict[str, Scores | None]

    def value(self, part: str, key: str) -> float | None:
        scores = self.parts.get(part)
        return None if scores is None else score_of(scores, key)

    def cell(self, part: str, key: str, show: _Show) -> str:
        scores = self.parts.get(part)
        ranged = interval(scores, key, share=show is wording.share) if scores else ""
        return f"{escape(show(self.value(part, key)))}{ranged}"


_COLUMNS: tuple[tuple[str, str, str, _Show], ...] = (
    ("stereo", "mover_within_2pct", WITHIN, wording.share),
    ("stereo", "mover_coverage", COVERAGE, wording.share),
    ("stereo", "static_coverage", STILL_COVERAGE, wording.share),
    ("multiview", "mover_within_2pct", f"All cameras: {WITHIN.lower()}", wording.share),
    ("multiview", "mover_coverage", f"All cameras: {COVERAGE.lower()}", wording.share),
    ("stitch", "overlap_flow_p95_px", "Panorama's misfit", pixels),
    ("poses", "right_pairs", "Pairs placed right", wording.share),
)


def conditions_table(result: CompareResult) -> str:
    """All conditions by a few measures, with intervals; nothing where there are no further ones."""
    if not result.conditions:
        return ""
    sides = wording.sides(result.stereo.synced if result.stereo else None, result.actual_offset_ms)
    rows = [
        _Row(sides.first.lower(), "", _parts(result, ("stereo", "stitch", "multiview", "poses"), "synced")),
        _Row(sides.late, "one camera of a pair", _parts(result, ("stereo", "stitch"), "offset")),
    ]
    drawn = any(_drawn(one) for one in result.conditions)
    if (result.multiview or result.poses) and not drawn:
        parts = _parts(result, ("multiview", "poses"), "offset")
        rows.append(_Row(wording.APART, "every camera off by another time", parts))
    for one in result.conditions:
        parts = _parts(one, ("stereo", "stitch", "multiview", "poses"), "offset")
        name = wording.APART if _drawn(one) else f"session {one.name}" if one.session else one.name
        rows.append(_Row(name, _details(one), parts))
    columns = [
        column for column in _COLUMNS if any(row.value(column[0], column[1]) is not None for row in rows)
    ]
    if not columns:
        return ""
    return listing(
        "All conditions, moving things",
        [Head("Condition"), *(Head(name) for _, _, name, _ in columns)],
        [
            [
                escape(row.name) + (f"<small>{escape(row.details)}</small>" if row.details else ""),
                *(row.cell(part, key, show) for part, key, _, show in columns),
            ]
            for row in rows
        ],
    )


def _parts(
    found: CompareResult | ConditionResult, names: Sequence[str], side: str
) -> dict[str, Scores | None]:
    parts = {}
    for name in names:
        comparison = getattr(found, name)
        parts[name] = getattr(comparison, side) if comparison is not None else None
    return parts


def _drawn(one: ConditionResult) -> bool:
    """Whether it is the condition that the parts with all cameras have anyway."""
    return not one.offsets_ms and not one.session


def _details(one: ConditionResult) -> str:
    late = (("depth", one.stereo_offset_ms), ("panorama", one.stitch_offset_ms))
    parts = [f"{what}: {wording.lateness(ms)}" for what, ms in late if ms is not None]
    if one.session:
        parts.append("other pictures, not paired by instant")
    elif one.offsets_ms:
        parts.insert(0, wording.offsets(one.offsets_ms))
    else:
        parts.append("every camera off by another time, drawn for each instant")
    return "; ".join([*parts, *one.skipped])


_INSTANT_COLUMNS: tuple[tuple[str, str, _Show], ...] = (
    ("mover_within_2pct", WITHIN, wording.share),
    ("mover_coverage", COVERAGE, wording.share),
    ("mover_epipolar_px", EPIPOLAR, pixels),
)


def instants_table(stereo: StereoComparison, names: wording.Sides) -> str:
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
            wording.number(row["mover_pixels"]),
            *(escape(show(row.get(f"{tone}_{key}"))) for key, _, show in columns for tone, _ in sides),
        ]
        for row in stereo.per_instant
    ]
    table = listing(f"Moving things, cameras {stereo.reference} and {stereo.other}", heads, rows)
    return f"<details><summary>Every instant by itself</summary>\n{table}</details>\n"
