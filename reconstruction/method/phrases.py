"""Phrases that several methods' sentences share."""

from reconstruction.method.comparison_results import CompareResult

UNSYNCHRONIZED = "unsynchronized"
EACH_DELAYED = "each camera off by a different delay"
"""The offset condition of studies of all cameras, as a word and as a phrase."""
CLEAR_FRACTION = 0.15
"""Lost fraction of the moving pixels from which sentences report the loss as clear."""


def late_text(result: CompareResult) -> str:
    """Return a pair's second camera's delay as a phrase: `66 ms late`."""
    return f"{result.actual_offset_ms:.0f} ms late"
