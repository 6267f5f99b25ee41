"""Tables of a page as data: both conditions side by side, all conditions, every instant by itself.

How late each camera of a rig is, as a table of a page.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

from reconstruction.report import wording
from reconstruction.report.findings import rig_judgement, rig_lateness
from reconstruction.report.measures import COVERAGE, EPIPOLAR, POINTS, STILL_COVERAGE, WITHIN, Measure, pixels
from reconstruction.scores.comparison_results import CompareResult, ConditionResult
from reconstruction.scores.study_result import DepthScores, PanoramaScores, PoseScores, TriangulationScores
from reconstruction.scores.timing import RigTiming

Scores = DepthScores | PanoramaScores | PoseScores | TriangulationScores
Show = Callable[[float | None], str]
"""Writes a value with its unit."""

PLAIN = (("", ""),)
WITH_CONTROL = (("mover_", "Moving things"), ("static_", "Things at rest (control)"))
"""Prefixes of a measure's fields, and the group of columns that shows them."""
PAIR = ("stereo", "stitch")
ALL_CAMERAS = ("multiview", "poses")
POINTS_STUDY = ("triangulation",)
"""Of the pair's condition where there are two cameras, else of all cameras'."""
CONDITION_COLUMNS: tuple[tuple[str, str, str, Show], ...] = (
    ("stereo", "mover_within_2pct", WITHIN, wording.share),
    ("stereo", "mover_coverage", COVERAGE, wording.share),
    ("stereo", "static_coverage", STILL_COVERAGE, wording.share),
    ("multiview", "mover_within_2pct", f"All cameras: {WITHIN.lower()}", wording.share),
    ("multiview", "mover_coverage", f"All cameras: {COVERAGE.lower()}", wording.share),
    ("stitch", "mover_misfit_px", "Panorama: misfit of moving things", pixels),
    ("triangulation", "mover_points", "Points by COLMAP", wording.number),
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
class Column:
    """A column's name, and the group and the condition (`synced`, `offset`) it belongs to."""

    name: str
    group: str = ""
    tone: str = ""

    @property
    def label(self) -> str:
        """Its name where it stands without its group above it."""
        return f"{self.group}, {self.name.lower()}" if self.group else self.name


@dataclass(frozen=True)
class Cell:
    """A value in words; a share (0..1) that is drawn as a bar, and small print beneath."""

    text: str
    share: float | None = None
    interval: str = ""
    note: str = ""
    control: bool = False


@dataclass(frozen=True)
class Row:
    """A row: its name with an explanation beneath it, and a cell for each column."""

    name: str
    cells: Sequence[Cell]
    details: str = ""
    link: str = ""


@dataclass(frozen=True)
class Table:
    """A table; `first` is the head of the column of names.

    A `twin` holds both conditions side by side, a row for each measure; a `listing` has a row for each
    thing, and becomes a card for each on a narrow screen, where `prefix` stands before the row's name.
    """

    caption: str
    columns: Sequence[Column]
    rows: Sequence[Row]
    kind: str = "listing"
    first: str = ""
    prefix: str = ""

    @property
    def groups(self) -> list[tuple[str, int]]:
        """Groups of neighbouring columns and how many columns each has; empty where there is no group."""
        found = [(group, len(list(ours))) for group, ours in groupby(self.columns, key=lambda one: one.group)]
        return found if any(group for group, _ in found) else []


def score_cell(scores: Scores | None, key: str, show: Show = wording.share, *, control: bool = False) -> Cell:
    """A measure of some scores with its 95 % interval over the instants."""
    value = None if scores is None else score_of(scores, key)
    found = None if scores is None else scores.intervals.get(key)
    is_share = show is wording.share
    ends = [] if found is None else [found.low, found.high]
    known = is_share and value is not None and not math.isnan(value)
    return Cell(
        show(value),
        share=min(max(value, 0.0), 1.0) if known and value is not None else None,
        interval=" to ".join(f"{100 * end:.1f}" if is_share else wording.quantity(end) for end in ends),
        control=control,
    )


def score_of(scores: Scores, key: str) -> float | None:
    """A measure by the name of its field."""
    value: float | None = getattr(scores, key)
    return value


def twin_table(
    caption: str,
    measures: Sequence[Measure],
    synced: Scores,
    offset: Scores,
    sides: wording.Sides,
    kinds: Sequence[tuple[str, str]] = PLAIN,
) -> Table:
    """Both conditions side by side, in each group of columns; measures without values are left out."""
    heads = ((sides.short, "synced"), (sides.late_short or sides.late_head, "offset"))
    rows = []
    for measure in measures:
        keys = [prefix + measure.key for prefix, _ in kinds]
        if all(score_of(scores, key) is None for key in keys for scores in (synced, offset)):
            continue
        cells = [
            score_cell(scores, key, measure.show, control=key.startswith("static_"))
            for key in keys
            for scores in (synced, offset)
        ]
        rows.append(Row(measure.name, cells, details=measure.text))
    columns = [Column(name, group, tone) for _, group in kinds for name, tone in heads]
    return Table(caption, columns, rows, kind="twin")


@dataclass(frozen=True)
class _Condition:
    """A condition: its name, details in words, and its scores by study."""

    name: str
    details: str
    scores: Mapping[str, Scores]


def conditions_table(result: CompareResult) -> Table:
    """All conditions by a few measures; no rows where there are no further ones."""
    sides = wording.name_sides(result, _cameras(result))
    every = PAIR + ALL_CAMERAS + POINTS_STUDY
    points = result.triangulation
    with_all = points is not None and len(points.cameras) > 2
    pair = PAIR if with_all else PAIR + POINTS_STUDY
    everybody = ALL_CAMERAS + POINTS_STUDY if with_all else ALL_CAMERAS
    listed = [
        _Condition(sides.first.lower(), "", _scores(result, every, "synced")),
        _Condition(sides.late, "one camera of a pair", _scores(result, pair, "offset")),
    ]
    if any(getattr(result, study) for study in everybody) and not any(map(_drawn, result.conditions)):
        scores = _scores(result, everybody, "offset")
        listed.append(_Condition(wording.UNSYNCHRONIZED, wording.EACH_DELAYED, scores))
    for one in result.conditions:
        name = wording.UNSYNCHRONIZED if _drawn(one) else f"session {one.name}" if one.session else one.name
        listed.append(_Condition(name, _details(one), _scores(one, every, "offset")))
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


def _cameras(result: CompareResult) -> tuple[str, ...]:
    """The cameras of all studies."""
    studies = (result.stereo, result.stitch, result.multiview, result.triangulation, result.poses)
    return tuple(dict.fromkeys(name for one in studies if one is not None for name in one.cameras))


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


def timing_table(rig: RigTiming) -> Table:
    """Every camera against the reference, by what moves: its lateness, and what follows from it."""
    rows = [
        Row(one.other, [Cell(rig_lateness(one) or wording.NOT_AVAILABLE), Cell(rig_judgement(one))])
        for one in rig.cameras
    ]
    return Table(
        f"When the cameras took their pictures, against {rig.reference}, by what moves; 95 %",
        [Column("Against it"), Column("Judged as")],
        rows,
        first="Camera",
    )
