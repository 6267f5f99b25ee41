"""What the tables of a report put into their cells: a value, a bar for a share, the interval beneath."""

import math
from collections.abc import Sequence
from html import escape

from reconstruction import wording
from reconstruction.results import DepthScores, StitchScores

WITHIN = "Measured correctly"
COVERAGE = "Given a distance"
EPIPOLAR = "Up-and-down mismatch"
STILL_COVERAGE = "At rest: given a distance"
"""What the measures are called, the same in every table."""


def listing(caption: str, heads: str, rows: Sequence[str]) -> str:
    """A table that scrolls by itself where it is wider than the page; `heads` and `rows` are HTML."""
    return f"""<div class="wide" role="region" aria-label="{escape(caption)}"><table class="listing">
<caption>{escape(caption)}</caption>
<thead><tr>{heads}</tr></thead><tbody>
{"".join(rows)}</tbody></table></div>"""


def meter(fraction: float | None) -> str:
    """A bar for a share 0..1; nothing for none."""
    if fraction is None or math.isnan(fraction):
        return ""
    return f'<span class="meter" style="--share: {min(max(fraction, 0.0), 1.0):.4f}"></span>'


def score_of(scores: DepthScores | StitchScores, name: str) -> float | None:
    """A measure by its name."""
    value: float | None = getattr(scores, name)
    return value


def interval(scores: DepthScores | StitchScores, name: str, share: bool) -> str:
    """The 95 % interval over the instants, small; empty where there is none."""
    found = scores.intervals.get(name)
    if found is None:
        return ""
    low, high = (
        (f"{100 * value:.1f}" if share else wording.quantity(value)) for value in (found.low, found.high)
    )
    return f'<small title="95 % interval over the instants">{low} to {high}</small>'
