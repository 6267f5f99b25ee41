"""Tables of a report that list: all conditions, and every instant by itself."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from reconstruction.report import wording
from reconstruction.report.measures import COVERAGE, EPIPOLAR, POINTS, STILL_COVERAGE, WITHIN, pixels
from reconstruction.report.tables import Cell, Column, Row, Scores, Show, Table, score_cell, score_of
from reconstruction.scores.compare_results import CompareResult, ConditionResult

PAIR = ("stereo", "stitch")
ALL_CAMERAS = ("multiview", "poses")
CONDITION_COLUMNS: tuple[tuple[str, str, str, Show], ...] = (
    ("stereo", "mover_within_2pct", WITHIN, wording.share),
    ("stereo", "mover_coverage", COVERAGE, wording.share),
    ("stereo", "static_coverage", STILL_COVERAGE, wording.share),
    ("multiview", "mover_within_2pct", f"All cameras: {WITHIN.lower()}", wording.share),
    ("multiview", "mover_coverage", f"All cameras: {COVERAGE.lower()}", wording.share),
    ("stitch", "overlap_flow_p95_px", "Panorama misfit", pixels),
    ("poses", "correct_pairs", "Camera pairs placed correctly", wording.share),
)
"""The study that takes the measure, its field, its name and how it is written."""
INSTANT_COLUMNS: tuple[tuple[str, str, Show], ...] = (
    ("mover_within_2pct", WITHIN, wording.share),
    ("mover_coverage", COVERAGE, wording.share),
    ("mover_epipolar_px", EPIPOLAR, pixels),
    ("mover_points", POINTS, wording.number),
)


@dataclass(frozen=True)
class _Condition:
    """A condition: its name, details in words, and its scores by study."""

    name: str
    details: str
    scores: Mapping[str, Scores]


def conditions_table(result: CompareResult, sides: wording.Sides) -> Table:
    """All conditions by a few measures; no rows where there are no further ones."""
    listed = [
        _Condition(sides.first.lower(), "", _scores(result, PAIR + ALL_CAMERAS, "synced")),
        _Condition(sides.late, "one camera of a pair", _scores(result, PAIR, "offset")),
    ]
    if (result.multiview or result.poses) and not any(map(_drawn, result.conditions)):
        scores = _scores(result, ALL_CAMERAS, "offset")
        listed.append(_Condition(wording.UNSYNCHRONIZED, wording.EACH_DELAYED, scores))
    for one in result.conditions:
        name = wording.UNSYNCHRONIZED if _drawn(one) else f"session {one.name}" if one.session else one.name
        listed.append(_Condition(name, _details(one), _scores(one, PAIR + ALL_CAMERAS, "offset")))
    columns = [
        (study, key, name, show)
        for study, key, name, show in CONDITION_COLUMNS
        if any(study in one.scores and score_of(one.scores[study], key) is not None for one in listed)
    ]
    rows = [
        Row(
            one.name,
            [score_cell(one.scores.get(study), key, show) for study, key, _, show in columns],
            details=one.details,
        )
        for one in listed
    ]
    return Table(
        "All conditions, moving things",
        [Column(name) for _, _, name, _ in columns],
        rows if result.conditions and columns else (),
        first="Condition",
    )


def _scores(found: CompareResult | ConditionResult, studies: Sequence[str], side: str) -> dict[str, Scores]:
    """One side's scores by study, of those that were made."""
    made = {study: getattr(found, study) for study in studies}
    return {study: getattr(one, side) for study, one in made.items() if one is not None}


def _drawn(one: ConditionResult) -> bool:
    """Whether it is the studies of all cameras' own condition."""
    return not one.offsets_ms and not one.session


def _details(one: ConditionResult) -> str:
    late = {"depth": one.stereo, "panorama": one.stitch}
    parts = [
        f"{what}: {wording.lateness(found.offset_ms)}"
        for what, found in late.items()
        if found is not None and found.offset_ms is not None
    ]
    if one.session:
        parts.append("another recording, not paired by instant")
    elif one.offsets_ms:
        parts.insert(0, wording.delays(one.offsets_ms))
    else:
        parts.append(f"{wording.EACH_DELAYED}, drawn at random for each instant")
    return "; ".join([*parts, *one.skipped])


def instants_table(
    caption: str, per_instant: Sequence[Mapping[str, float | None]], sides: wording.Sides
) -> Table:
    """Every instant's numbers on moving things in both conditions; no rows where there are none."""
    tones = (("synced", sides.short), ("offset", sides.late_short or sides.late_head))
    columns = [
        column
        for column in INSTANT_COLUMNS
        if any(row.get(f"synced_{column[0]}") is not None for row in per_instant)
    ]
    counted = any(row.get("mover_pixels") is not None for row in per_instant)
    rows = []
    for row in per_instant if columns else ():
        cells = [Cell(wording.number(row.get("mover_pixels")))] if counted else []
        cells += [Cell(show(row.get(f"{tone}_{key}"))) for key, _, show in columns for tone, _ in tones]
        rows.append(Row(f"{row['instant']}", cells))
    heads = [Column("Moving pixels")] if counted else []
    heads += [Column(side, name, tone) for _, name, _ in columns for tone, side in tones]
    return Table(caption, heads, rows, first="Instant", prefix="Instant ")
