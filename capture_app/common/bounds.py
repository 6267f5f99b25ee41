"""Base of the messages of machines, and types of their numbers and texts; what exceeds them is refused."""

from typing import Annotated

from msgspec import Meta, Struct

CENTURY_NS = 3_155_760_000_000_000_000
"""Sums and differences of two such times fit into 64 bits."""
MAX_COUNT = 10**18
MAX_TEXT = 200

TimeNs = Annotated[int, Meta(ge=-CENTURY_NS, le=CENTURY_NS)]
"""Time in ns, or a difference of two: within a century of its clock's zero."""
Count = Annotated[int, Meta(ge=0, le=MAX_COUNT)]
"""Number of things, or a duration in ns of at most 31 years."""
Positive = Annotated[int, Meta(gt=0, le=MAX_COUNT)]
Number = Annotated[int, Meta(ge=0, le=0xFFFF_FFFF)]
"""Number of a client, of a burst, or of one run of a leader."""
Instance = Annotated[int, Meta(ge=0, le=1 << 62)]
"""Number of one run of a node."""
Pixels = Annotated[int, Meta(ge=0, le=1 << 20)]
RowTimeNs = Annotated[int, Meta(ge=0, le=1_000_000_000)]
Real = Annotated[float, Meta(gt=-1e15, lt=1e15)]
Ppm = Annotated[float, Meta(ge=-1e6, le=1e6)]
"""Relative rate of two clocks, or of a stream and its grid, in parts per million."""
Text = Annotated[str, Meta(max_length=MAX_TEXT)]
Sentence = Annotated[str, Meta(max_length=1000)]
FilePath = Annotated[str, Meta(max_length=4096)]


class Message(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Message of a stream, identified by its tag; unknown fields are an error."""


def sendable(value: float, limit: int = MAX_COUNT) -> int | None:
    """Return a value as a whole number; None if it exceeds its type's limit and all receivers refuse it.

    A forged clock causes such values. A message that is refused whole is never answered.
    """
    return round(value) if abs(value) <= limit else None


def cut(text: str, max_letters: int = MAX_TEXT) -> str:
    """Return a text of at most so many letters; the end of a longer one is replaced by dots."""
    return text if len(text) <= max_letters else text[: max_letters - 3] + "..."
