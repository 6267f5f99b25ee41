"""The sessions of takes, which are numbered by what their names begin with."""

from pathlib import Path

from capture_app.errors import BadInputError
from capture_app.session.writing.session_writer import SessionWriter

UNNAMED, RECORDING = "burst", "recording"
"""What the sessions of takes without a name begin with."""
MAX_FOLDER_NUMBER = 999_999


def create_numbered(root: Path, prefix: str = UNNAMED, *, after: int = 0) -> tuple[SessionWriter, int]:
    """Begin the session `PREFIX-NNN` of the next free number over `after`, and return that number too.

    Raises BadInputError, DiskFullError.
    """
    number = 1 + max([after, *(_number(path, prefix) for path in root.glob(f"{prefix}-*"))])
    while True:
        name = f"{prefix}-{number:03d}"
        try:
            return SessionWriter.create(root, name), number
        except BadInputError:
            if not (root / name).exists():
                raise
        number += 1


def _number(path: Path, prefix: str) -> int:
    digits = path.name.removeprefix(f"{prefix}-")
    return int(digits) if digits.isdecimal() and len(digits) <= len(str(MAX_FOLDER_NUMBER)) else 0
