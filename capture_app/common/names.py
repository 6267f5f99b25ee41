"""Names of cameras, nodes, rigs and sessions: their syntax, which is valid for folders, and their order."""

import re
from collections.abc import Collection, Iterable
from itertools import chain, count
from typing import Annotated
from unicodedata import combining, normalize

from msgspec import Meta

from capture_app.common.errors import BadInputError

_MAX_LENGTH = 64
_PATTERN = rf"[A-Za-z0-9][A-Za-z0-9_.-]{{0,{_MAX_LENGTH - 1}}}"
_FORBIDDEN = re.compile(r"[^A-Za-z0-9_.-]+")
_RESERVED = re.compile(r"^(con|prn|aux|nul|com\d|lpt\d)(?=\.|$)", re.IGNORECASE)
"""Windows' devices: a folder cannot have their names, whatever follows a dot, and none may end with a dot."""

Name = Annotated[str, Meta(pattern=rf"^{_PATTERN}$(?!\n)")]
"""Type of a name in messages and records. Python's `$` alone would accept a line end after it."""


def is_name(text: str) -> bool:
    """Whether a text is a valid name of a camera, a node, a rig or a session."""
    return re.fullmatch(_PATTERN, text) is not None


def check_name(text: str, what: str) -> str:
    """Return a valid name unchanged; `what` it names is for the error. Raises BadInputError.

    Names that are no folders on Windows are refused on all systems, because sessions travel.
    """
    if not is_name(text) or text.endswith(".") or _RESERVED.match(text):
        near = name_like(text, "")
        raise BadInputError(
            f"{text!r} is not a valid name for a {what}",
            hint=f"up to {_MAX_LENGTH} letters, digits, '_', '.' and '-', beginning with a letter or a digit"
            + (f", such as {near}" if near else ""),
        )
    return text


def name_like(text: str, otherwise: str) -> str:
    """Return the valid name nearest to a text without accents, or `otherwise` if nothing is usable."""
    plain = "".join(
        character for character in normalize("NFKD", text.replace("ß", "ss")) if not combining(character)
    )
    near = _FORBIDDEN.sub("-", plain).lstrip("_.-")[: _MAX_LENGTH - 1].rstrip("-.")
    return _RESERVED.sub(r"\1_", near) or otherwise


def find_alike(name: str, others: Iterable[str]) -> str | None:
    """Return the one of `others` that differs by case at most: such folders are one on Windows and macOS."""
    return next((other for other in others if other.casefold() == name.casefold()), None)


def free_name(requested: str, taken: Collection[str]) -> str:
    """Return the requested name, or the first of NAME-2, NAME-3 ... that is not taken, whatever the case."""
    numbered = (f"{requested}-{number}" for number in count(2))
    return next(name for name in chain((requested,), numbered) if find_alike(name, taken) is None)


def natural_order(text: str) -> list[tuple[int, str]]:
    """Return a sort key that puts cam2 before cam10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", text) if part]
