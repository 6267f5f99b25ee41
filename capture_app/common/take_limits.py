"""Limits of a take's numbers, the same for the command, the screen, Python and the leader."""

import operator
from collections.abc import Mapping

from msgspec import Meta

from capture_app.common.bounds import CENTURY_NS
from capture_app.common.errors import BadInputError

DAY_S = 86_400.0
LONGEST_S = 31 * DAY_S
LIMITS: Mapping[str, tuple[int, int] | tuple[float, float]] = {
    "frames": (1, 100_000),
    "before": (0, 1000),
    "spacing": (1, 1_000_000),
    "interval_s": (1e-4, 1e5),
    "spare": (0, 999),
    "seconds": (1e-3, LONGEST_S),
    "at_leader_ns": (-CENTURY_NS, CENTURY_NS),
    "wait_ready_s": (0.0, LONGEST_S),
    "nodes": (1, 100_000),
    "countdown_s": (0.0, DAY_S),
    "repeat": (1, 10_000),
    "every_s": (0.0, DAY_S),
    "wait_leader_s": (0.0, DAY_S),
}
"""Minimum and maximum of each number, by its name in a plan; whole numbers have whole limits."""


def meta(field: str) -> Meta:
    """Return the limits as constraints of a message's field."""
    low, high = LIMITS[field]
    return Meta(ge=low, le=high)


def limited(field: str, value: object) -> int | float:
    """Return a number of Python or NumPy as one of Python. Raises BadInputError beyond the limits."""
    low, high = LIMITS[field]
    is_whole = isinstance(high, int)
    try:
        number = operator.index(value) if is_whole else _real(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = None
    if number is None or not low <= number <= high:
        hint = f"give {'a whole number from ' if is_whole else ''}{low:g} to {high:g}"
        raise BadInputError(f"{field} of a take is {value!r}", hint=hint)
    return number


def _real(value: object) -> float | None:
    return None if isinstance(value, str | bytes) else float(value)  # type: ignore[arg-type]


def check_before(before: int, frames: int | None) -> None:
    """Raise BadInputError for more frames before the request than the take has; `frames`: None if unknown."""
    if frames is None and before:
        raise BadInputError(
            "a take by its duration has no frames from before the request", hint="leave out before"
        )
    if frames is not None and before > frames:
        raise BadInputError(
            f"{before} of {frames} frames cannot be taken before the request", hint="ask for more frames"
        )
