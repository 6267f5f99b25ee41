"""Names of cameras, nodes, rigs and sessions: their syntax, which is valid for folders, and their order.

A label is what an owner wrote, in any script; the folder's name that is made of it is a `Name`.
"""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import chain, count
from typing import Annotated
from unicodedata import combining, normalize

from msgspec import Meta

from capture_app.common.errors import BadInputError

_MAX_LENGTH = 64
_PATTERN = rf"[A-Za-z0-9][A-Za-z0-9_.-]{{0,{_MAX_LENGTH - 1}}}"
_FORBIDDEN = re.compile(r"[^A-Za-z0-9_.-]+")
_NO_LABEL = re.compile(r"[\x00-\x1f\x7f-\x9f=/\\]+")
_RESERVED = re.compile(r"^(con|prn|aux|nul|com\d|lpt\d)(?=\.|$)", re.IGNORECASE)
"""Windows' devices: a folder cannot have their names, whatever follows a dot, and none may end with a dot."""

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
VIDEO_SUFFIXES = (
    *(".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".insv"),
    *(".mjpg", ".mjpeg", ".mpg", ".mpeg", ".h264", ".264", ".mts", ".m2ts", ".ts", ".wmv"),
)
FOOTAGE = (*VIDEO_SUFFIXES, *IMAGE_SUFFIXES)
"""Endings of the names of files that are imported, and that people take for a session or a command."""

Name = Annotated[str, Meta(pattern=rf"^{_PATTERN}$(?!\n)")]
"""Type of a name in messages and records. Python's `$` alone would accept a line end after it."""

Label = Annotated[str, Meta(max_length=255)]
"""Type of a label in messages and records; 255 is the longest name of a file."""


def is_name(text: str) -> bool:
    """Whether a text is a valid name of a camera, a node, a rig or a session."""
    return re.fullmatch(_PATTERN, text) is not None


def check_name(text: str, what: str) -> str:
    """Return a valid name unchanged; `what` it names is for the error. Raises BadInputError.

    Names that are no folders on Windows are refused on all systems, because sessions travel.
    """
    if not _is_folder_name(text):
        near = name_like(text, "")
        raise BadInputError(
            f"{text!r} is not a valid name for a {what}",
            hint=f"up to {_MAX_LENGTH} letters, digits, '_', '.' and '-', beginning with a letter or a digit"
            + (f", such as {near}" if near else ""),
        )
    return text


def typed_name(text: str, what: str) -> str:
    """Return a typed name with '-' for blanks: `my take` is my-take. Raises BadInputError."""
    return check_name("-".join(text.split()), what)


def _is_folder_name(text: str) -> bool:
    return is_name(text) and not text.endswith(".") and not _RESERVED.match(text)


def label_of(text: str) -> str:
    """Return a text as a label: in one form of Unicode (NFC), without what `NAME=PATH` cannot have."""
    # Names of files need not be UTF-8.
    valid = _NO_LABEL.sub("-", normalize("NFC", text)).encode("utf-8", "replace").decode()
    return " ".join(valid.split())[:255]


def check_label(text: str, what: str) -> str:
    """Return a text as a label of `what` it names. Raises BadInputError if it cannot be one."""
    return label_of(text) if text.strip() and not _NO_LABEL.search(text) else check_name(text, what)


def label_key(text: str) -> str:
    """Return what equal labels have in common, whatever their letter case and their form of Unicode."""
    return normalize("NFC", normalize("NFC", text).casefold())


def folder_names(labels: Sequence[str], what: str, otherwise: str) -> list[str]:
    """Return a folder's name for each label: itself if it can be one, else the nearest that is free.

    `otherwise`, with the label's place, is the name of labels without a letter of ASCII. Raises BadInputError
    for labels that other systems may take for one: `what` they name is for the error.
    """
    keys = Counter(map(label_key, labels))
    if twice := [label for label in labels if keys[label_key(label)] > 1]:
        raise BadInputError(f"two {what}s are named {twice[0]}", hint="name them: NAME=PATH")
    names: dict[str, str] = {}
    # A folder's name belongs first of all to the label that is equal to it.
    for number, label in sorted(enumerate(labels), key=lambda numbered: not _is_folder_name(numbered[1])):
        nearest = label if _is_folder_name(label) else name_like(label, f"{otherwise}{number}")
        names[label] = free_name(nearest, names.values())
    return [names[label] for label in labels]


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
    numbered = (f"{requested[: _MAX_LENGTH - 8]}-{number}" for number in count(2))
    return next(name for name in chain((requested,), numbered) if find_alike(name, taken) is None)


def natural_order(text: str) -> list[tuple[int, str]]:
    """Return a sort key that puts cam2 before cam10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", text) if part]


def titles_of(labels: Mapping[str, str]) -> dict[str, str]:
    """Return what people call cameras, by name: their labels, beside the name where several have one."""
    times = Counter(labels.values())
    return {name: label if times[label] == 1 else f"{label} ({name})" for name, label in labels.items()}
