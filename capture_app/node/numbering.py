"""Sessions named after their bursts: `burst-NNN`, the number that the whole rig knows the burst by."""

from pathlib import Path

from capture_app.errors import BadInputError
from capture_app.session.store import SessionWriter


def create_numbered(root: Path, *, after: int = 0) -> tuple[SessionWriter, int]:
    """Begin the session `burst-NNN` of the next free number over `after`, and return that number too.

    Raises BadInputError, DiskFullError.
    """
    number = 1 + max([after, *(_number(path) for path in root.glob("burst-*"))])
    while True:
        name = f"burst-{number:03d}"
        try:
            return SessionWriter.create(root, name), number
        except BadInputError:
            if not (root / name).exists():
                raise
        number += 1


def _number(path: Path) -> int:
    digits = path.name.removeprefix("burst-")
    return int(digits) if digits.isdecimal() else 0
