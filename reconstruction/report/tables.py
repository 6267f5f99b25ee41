"""Tables of a page as data: columns, rows and cells, and how a score fills a cell."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby

from reconstruction.report import wording
from reconstruction.report.measures import Measure
from reconstruction.scores.depth_results import DepthScores
from reconstruction.scores.panorama_results import PanoramaScores
from reconstruction.scores.pose_results import PoseScores

Scores = DepthScores | PanoramaScores | PoseScores
Show = Callable[[float | None], str]
"""Writes a value with its unit."""

PLAIN = (("", ""),)
WITH_CONTROL = (("mover_", "Moving things"), ("static_", "Things at rest (control)"))
"""Prefixes of a measure's fields, and the group of columns that shows them."""


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
            score_cell(scores, key, measure.show, control=measure.control or key.startswith("static_"))
            for key in keys
            for scores in (synced, offset)
        ]
        rows.append(Row(measure.name, cells, details=measure.text))
    columns = [Column(name, group, tone) for _, group in kinds for name, tone in heads]
    return Table(caption, columns, rows, kind="twin")
