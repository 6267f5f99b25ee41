"""Whether the pictures that a command reads are those that were saved: by their checksums, as they are read.

A command says what happens to others (`checked_pictures`): they are used, and named for the user and the
result, or refused.
"""

import hashlib
from contextlib import AbstractContextManager
from contextvars import ContextVar
from pathlib import Path

from capture_app.common.errors import IncompleteError
from reconstruction.common.memory import running

_VERIFY = "capture-app sessions verify checks every image"


class PictureChecks:
    """The checksums of a command's pictures, and which pictures differ from theirs."""

    def __init__(self, *, required: bool) -> None:
        self.required = required
        self._changed: dict[Path, None] = {}

    @property
    def changed(self) -> tuple[str, ...]:
        """The files whose bytes are not those that were saved, in the order in which they were read."""
        return tuple(str(path) for path in self._changed)

    @property
    def notes(self) -> tuple[str, ...]:
        """One sentence about them for the user, none where all were as saved."""
        if not self._changed:
            return ()
        first, *others = self.changed
        also = f" (and {len(others)} more)" if others else ""
        return (
            f"{first}{also}: not the bytes that were saved, by its checksum, and used all the same. "
            f"{_VERIFY}; --require-checksums refuses such pictures",
        )

    def check(self, path: Path, data: bytes, sha256: str) -> None:
        """Hold the bytes of a picture in a file against its checksum.

        Raises:
            IncompleteError: they differ, and checksums are required.
        """
        if hashlib.sha256(data).hexdigest() == sha256:
            return
        if self.required:
            raise IncompleteError(f"{path} is damaged: its checksum is not the session's", hint=_VERIFY)
        self._changed[path] = None


def picture_checks() -> PictureChecks:
    """The checks of the running command; outside of any, changed pictures are used."""
    return _checks.get(None) or PictureChecks(required=False)


def checked_pictures(*, required: bool) -> AbstractContextManager[PictureChecks]:
    """Check the pictures that are read within."""
    return running(_checks, PictureChecks(required=required))


_checks: ContextVar[PictureChecks] = ContextVar("checks")
