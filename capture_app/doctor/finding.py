"""What one look has found."""

from typing import Literal

from msgspec import Struct

Grade = Literal["good", "note", "warning", "problem"]
"""A problem keeps this machine from taking part, a warning makes it worse or less sure."""


class Finding(Struct, frozen=True, kw_only=True):
    """One of them; `remedy` is the line that repairs it, or says what to do."""

    check: str
    grade: Grade
    text: str
    remedy: str = ""
