"""Phrases that several methods' sentences share."""

from typing import Any

from reconstruction.method.comparison_results import CompareResult
from reconstruction.method.study_result import StudyResult

UNSYNCHRONIZED = "unsynchronized"
EACH_DELAYED = "each camera off by a different delay"
"""The offset condition of studies of all cameras, as a word and as a phrase."""
DEPTH_MEASURES = ("mover_within_2pct", "mover_coverage")
"""Measures that judge depth: correct distances if the truth is known, else any distance."""
CLEAR_FRACTION = 0.15
"""Lost fraction of the moving pixels from which the loss is reported as clear."""


def late_text(result: CompareResult) -> str:
    """Return a pair's second camera's delay as a phrase: `66 ms late`."""
    return f"{result.actual_offset_ms:.0f} ms late"


def percent(fraction: float) -> str:
    """Return a fraction 0..1 as a percentage for a sentence."""
    return f"{100 * fraction:.0f} %" if fraction >= 0.01 or fraction == 0 else "under 1 %"


def depth_sentence(depth: StudyResult[Any], when: str, late: str, agreed: str) -> str:
    """Return a sentence with the moving fraction found in each condition; empty without a clear loss."""
    if (known := depth.first_known(*DEPTH_MEASURES)) is None or known[1] - known[2] < CLEAR_FRACTION:
        return ""
    measure, synced, offset = known
    correct = measure == DEPTH_MEASURES[0]
    what = "the right distance is found" if correct else f"a distance is found that {agreed}"
    return f"When {when}, {what} for {percent(synced)} of what moves; with {late}, for {percent(offset)}."


def late_or_early(late_ms: float, uncertainty_ms: float) -> str:
    """Return `0.4 ± 0.6 ms late`, or early."""
    return f"{abs(late_ms):.1f} ± {uncertainty_ms:.1f} ms {'early' if late_ms < 0 else 'late'}"
