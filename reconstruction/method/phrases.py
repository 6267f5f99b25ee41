"""Phrases that several methods' sentences share."""

from typing import Any

from reconstruction.method.comparison_results import CompareResult

UNSYNCHRONIZED = "unsynchronized"
EACH_DELAYED = "each camera off by a different delay"
"""The offset condition of studies of all cameras, as a word and as a phrase."""
CLEAR_FRACTION = 0.15
"""Lost fraction of the moving pixels from which sentences report the loss as clear."""
EQUAL_FRACTION = 0.02
"""Difference of two fractions of what stands still up to which they are called equal."""
OTHER_CAUSE_FRACTION = 0.1
"""Lost fraction of what stands still from which timing is not called the only cause."""
CLEAR_FACTOR = 1.5
"""Factor by which an error or a step in pixels grows from which sentences report it."""
FEW_FACTOR = 2.0
"""Factor of the angles' error below which a sentence counts the pairs of cameras that are right instead."""
STILL_FRACTION = 0.0005
"""Moving fraction of the pictures below which nothing is said to move."""
LIMITS: dict[str, Any] = {
    "clear_fraction": CLEAR_FRACTION,
    "equal_fraction": EQUAL_FRACTION,
    "other_cause_fraction": OTHER_CAUSE_FRACTION,
    "clear_factor": CLEAR_FACTOR,
    "few_factor": FEW_FACTOR,
    "still_fraction": STILL_FRACTION,
}
"""These numbers by the names that templates have for them."""


def late_text(result: CompareResult) -> str:
    """Return a pair's second camera's delay as a phrase: `66 ms late`."""
    return f"{result.actual_offset_ms:.0f} ms late"
