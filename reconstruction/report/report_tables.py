"""Tables of a page as data: both conditions, all conditions, every instant, every camera."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from reconstruction.common import wording
from reconstruction.method.comparison_results import CompareResult, ConditionResult
from reconstruction.method.phrases import EACH_DELAYED, UNSYNCHRONIZED
from reconstruction.method.score import study_reports
from reconstruction.method.study_result import Interval, StudyResult
from reconstruction.method.tally import CONDITIONS
from reconstruction.method.timing import SessionTiming
from reconstruction.report.findings import ConditionNames, name_conditions, offset_text, sentences

WITH_CONTROL = (("mover_", "Moving things"), ("static_", "Things at rest (control)"))
"""Prefixes of a measure's name, each with the column group that shows it."""


@dataclass(frozen=True)
class Column:
    """A column's name, group and tone: its condition (`synced`, `offset`), or `words` for sentences."""

    name: str
    group: str = ""
    tone: str = ""


@dataclass(frozen=True)
class Cell:
    """A value in words, a fraction (0..1) drawn as a bar, and small print."""

    text: str
    fraction: float | None = None
    interval: str = ""
    note: str = ""
    control: bool = False


@dataclass(frozen=True)
class Row:
    """A row: its name with an explanation below it, and a cell for each column."""

    name: str
    cells: Sequence[Cell]
    details: str = ""
    link: str = ""


@dataclass(frozen=True)
class Table:
    """A table; `first` is the head of the column of names.

    A `twin` shows both conditions side by side, one row for each measure. A `listing` has one row for each
    item. On a narrow screen each becomes a card, with `prefix` before the row's name.
    """

    caption: str
    columns: Sequence[Column]
    rows: Sequence[Row]
    kind: str = "listing"
    first: str = ""
    prefix: str = ""

    @property
    def groups(self) -> list[tuple[str, int]]:
        """Groups of neighbouring columns with their column counts; empty if no column has a group."""
        groups = [
            (group, len(list(ours))) for group, ours in groupby(self.columns, key=lambda one: one.group)
        ]
        return groups if any(group for group, _ in groups) else []


def interval_cell(found: Interval | None, unit: str, *, control: bool = False) -> Cell:
    """Return a cell with a measure and its 95 % interval over the instants; a fraction also gets a bar."""
    if found is None:
        return Cell(wording.NOT_AVAILABLE, control=control)
    is_fraction = unit == wording.PERCENT
    ends = [f"{100 * end:.1f}" if is_fraction else wording.quantity(end) for end in found.ends]
    return Cell(
        wording.measured(found.value, unit),
        fraction=min(max(found.value, 0.0), 1.0) if is_fraction else None,
        interval=" to ".join(ends) if found.low is not None else "",
        control=control,
    )


def study_table(study: StudyResult[Any], names: ConditionNames) -> Table:
    """Return both conditions side by side in each column group; measures without values are left out."""
    reported = study_reports()[study.name]
    text, placeholders = reported.text, reported.placeholders(study)
    groups = WITH_CONTROL if text.control else (("", ""),)
    sides = [(prefix, side) for prefix, _ in groups for side in CONDITIONS]
    known = {measure.name for measure in study.measures if measure.synced or measure.offset}
    rows = [
        Row(
            measure.name,
            [
                interval_cell(
                    study.interval(prefix + measure.key, side), measure.unit, control=prefix == "static_"
                )
                for prefix, side in sides
            ],
            details=measure.text.format(**placeholders),
        )
        for measure in text.measures
        if any(prefix + measure.key in known for prefix, _ in groups)
    ]
    columns = [Column(head, group, tone) for _, group in groups for tone, head in names.heads.items()]
    return Table(text.caption.format(**placeholders), columns, rows, kind="twin")


def conditions_table(result: CompareResult) -> Table:
    """Return a table of all conditions with a few measures; without rows for only two conditions."""
    made = [study for study in result.studies if not study.skipped]
    pairs, everybody = (
        [study for study in made if (len(study.cameras) > 2) is many] for many in (False, True)
    )
    first = name_conditions(result, list({name for study in made for name in study.cameras})).first.lower()
    listed = [
        (first, "", _intervals(made, "synced")),
        (wording.offset_text(result.actual_offset_ms), "one camera of a pair", _intervals(pairs, "offset")),
    ]
    if everybody and not any(map(_is_drawn, result.conditions)):
        listed.append((UNSYNCHRONIZED, EACH_DELAYED, _intervals(everybody, "offset")))
    for one in result.conditions:
        name = UNSYNCHRONIZED if _is_drawn(one) else f"session {one.name}" if one.session else one.name
        listed.append((name, _details(one), _intervals(one.studies, "offset")))
    columns = [
        (study, measure, head)
        for study in (score.text for score in study_reports().values())
        for measure, head in study.condition_columns
        if any((study.name, measure) in found for *_, found in listed)
    ]
    rows = [
        Row(
            name,
            [
                interval_cell(found.get((study.name, measure)), study.unit(measure))
                for study, measure, _ in columns
            ],
            details=details,
        )
        for name, details, found in listed
    ]
    return Table(
        "All conditions, moving things",
        [Column(name) for _, _, name in columns],
        rows if result.conditions and columns else (),
        first="Condition",
    )


def _intervals(studies: Sequence[StudyResult[Any]], side: str) -> dict[tuple[str, str], Interval]:
    """Return the value and interval of every measure in one condition (`side`), by study and measure."""
    return {
        (study.name, measure.name): interval
        for study in studies
        for measure in study.measures
        if (interval := measure.side(side)) is not None
    }


def _is_drawn(one: ConditionResult) -> bool:
    """Return whether a condition's delays are drawn at random, as in the built-in one of all cameras."""
    return not one.offsets_ms and not one.session


def _details(one: ConditionResult) -> str:
    subjects = {study.name: study_reports()[study.name].text.subject for study in one.studies}
    late = [
        f"{subjects[study.name]}: {wording.offset_text(study.late_ms)}"
        for study in one.studies
        if len(study.cameras) == 2 and not study.skipped and study.late_ms is not None
    ]
    skipped = [f"{subjects[study.name]}: {study.skipped}" for study in one.studies if study.skipped]
    if one.offsets_ms and not one.session:
        return "; ".join([wording.delays(one.offsets_ms), *late, *skipped])
    drawn = f"{EACH_DELAYED}, drawn at random for each instant"
    return "; ".join([*late, "another recording, not paired by instant" if one.session else drawn, *skipped])


def instants_table(caption: str, study: StudyResult[Any], names: ConditionNames) -> Table:
    """Return every instant's numbers on moving things in both conditions; without rows if there are none."""
    text = study_reports()[study.name].text
    known = {key for row in study.per_instant for key, value in row.items() if value is not None}
    measures = {column: name for column, name in text.instant_columns if f"synced_{column}" in known}
    columns = [("mover_pixels", wording.COUNT)] if "mover_pixels" in known else []
    heads = [Column("Moving pixels") for _ in columns]
    for measure, name in measures.items():
        columns += [(f"{side}_{measure}", text.unit(measure)) for side in CONDITIONS]
        heads += [Column(head, name, tone) for tone, head in names.heads.items()]
    rows = [
        Row(f"{row['instant']}", [Cell(wording.measured(row.get(key), unit)) for key, unit in columns])
        for row in study.per_instant
    ]
    return Table(caption, heads, rows if measures else (), first="Instant", prefix="Instant ")


def timing_table(rig: SessionTiming) -> Table:
    """Return every camera's time offset against the reference, measured by motion, and the judgement."""
    rows = [
        Row(
            camera.other,
            [
                Cell(offset_text(camera) or wording.NOT_AVAILABLE),
                Cell(sentences("judgement.txt", timing=camera)),
            ],
        )
        for camera in rig.cameras
    ]
    return Table(
        f"Time offset of each camera against {rig.reference}, by what moves; 95 %",
        [Column("Time offset"), Column("Verdict", tone="words")],
        rows,
        first="Camera",
    )
