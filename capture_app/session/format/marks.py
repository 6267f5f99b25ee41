"""Marks: events that an operator noted at a time of the rig, stored among the events of a session."""

from collections.abc import Iterable, Iterator
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct

from capture_app.common.bounds import Count, TimeNs
from capture_app.common.errors import BadInputError

MARK_EVENT = "mark"
RIG_MARKS = "marks.ndjson"
"""File in a rig's sessions folder with the marks that fell into no take."""
MAX_MARK_TEXT = 200
MarkText = Annotated[str, Meta(min_length=1, max_length=MAX_MARK_TEXT)]


class Mark(Struct, frozen=True, kw_only=True):
    """Event noted by an operator, such as a stimulus."""

    text: MarkText
    leader_ns: TimeNs
    """Time of the event in the leader's clock, ns, as the session's images have it."""
    uncertainty_ns: Count
    """Maximum error of that time, ns."""

    def as_event(self) -> dict[str, Any]:
        """Return the mark as a line of a session's events."""
        return {"event": MARK_EVENT, **msgspec.to_builtins(self)}


def check_mark_text(text: str) -> None:
    """Raise BadInputError for a text that a mark cannot have."""
    if not 0 < len(text) <= MAX_MARK_TEXT or not text.isprintable():
        raise BadInputError(
            f"a mark cannot have the text {text[:40]!r}",
            hint=f"use 1 to {MAX_MARK_TEXT} characters on one line, such as stimulus",
        )


def marks_of(lines: Iterable[bytes]) -> Iterator[Mark]:
    """Yield the marks among lines of events, skipping everything else."""
    for line in lines:
        try:
            event = msgspec.json.decode(line, type=dict[str, Any])
            if event.get("event") == MARK_EVENT:
                yield msgspec.convert(event, Mark)
        except (msgspec.MsgspecError, UnicodeDecodeError):
            continue
