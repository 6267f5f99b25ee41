"""What the tables of a report put into their cells: a value, a bar for a share, the interval beneath."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from itertools import groupby

from reconstruction.report import wording
from reconstruction.scores.depth_results import DepthScores
from reconstruction.scores.panorama_results import PanoramaScores
from reconstruction.scores.pose_results import PoseScores

Scores = DepthScores | PanoramaScores | PoseScores

WITHIN = "Measured correctly"
COVERAGE = "Given a distance"
EPIPOLAR = "Up-and-down mismatch"
STILL_COVERAGE = "At rest: given a distance"
"""What the measures are called, the same in every table."""


@dataclass(frozen=True)
class Head:
    """The head of a column: its name, and the group and the tone (`synced`, `offset`) it belongs to."""

    name: str
    group: str = ""
    tone: str = ""

    def alone(self) -> str:
        """Its name where it stands without its group above it."""
        return f"{self.group}, {self.name.lower()}" if self.group else self.name

    def html(self) -> str:
        """The column's own head."""
        dot = '<span class="dot"></span>' if self.tone else ""
        return f'<th scope="col" class="{self.tone}">{dot}{escape(self.name)}</th>'


def listing(caption: str, heads: Sequence[Head], rows: Sequence[Sequence[str]]) -> str:
    """A table with a row for each thing; on a narrow screen a card for each.

    Cells are HTML; the first of a row names it. Columns of one group must be neighbours.
    """
    body = []
    for row in rows:
        cells = "".join(
            f'<td data-head="{escape(head.alone())}">{cell}</td>'
            for head, cell in zip(heads[1:], row[1:], strict=True)
        )
        body.append(f'<tr><th scope="row">{row[0]}</th>{cells}</tr>\n')
    groups = ""
    if any(head.group for head in heads):
        spans = [(group, len(list(ours))) for group, ours in groupby(heads, key=lambda head: head.group)]
        groups = "".join(
            f'<th scope="colgroup" colspan="{count}">{escape(group)}</th>'
            if group
            else f'<td colspan="{count}"></td>'
            for group, count in spans
        )
        groups = f"<tr>{groups}</tr>\n"
    return f"""<table class="listing"><caption>{escape(wording.tie(caption))}</caption>
<thead>{groups}<tr>{"".join(head.html() for head in heads)}</tr></thead>
<tbody>
{"".join(body)}</tbody></table>"""


def meter(fraction: float | None) -> str:
    """A bar for a share 0..1; nothing for none."""
    if fraction is None or math.isnan(fraction):
        return ""
    return f'<span class="meter" style="--share: {min(max(fraction, 0.0), 1.0):.4f}"></span>'


def score_of(scores: Scores, name: str) -> float | None:
    """A measure by its name."""
    value: float | None = getattr(scores, name)
    return value


def interval(scores: Scores, name: str, share: bool) -> str:
    """The 95 % interval over the instants, small; empty where there is none."""
    found = scores.intervals.get(name)
    if found is None:
        return ""
    low, high = (
        (f"{100 * value:.1f}" if share else wording.quantity(value)) for value in (found.low, found.high)
    )
    return f'<small title="95 % interval over the instants">{low} to {high}</small>'
