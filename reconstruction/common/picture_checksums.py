"""Checksum verification of images while a command reads them.

Changed images are used, and reported to the user and in the result; or they are refused (`REQUIRED`).
"""

import hashlib
import os
from contextlib import AbstractContextManager
from contextvars import ContextVar
from pathlib import Path

from capture_app.common.errors import IncompleteError
from reconstruction.common.memory import running

REQUIRED = "SIMULSHOT_REQUIRE_CHECKSUMS"
"""Environment variable that, if not empty, makes commands refuse images that have changed."""
_VERIFY = "capture-app sessions verify checks every image"


class PictureChecks:
    """Checksum verification for one command, and the images that failed it."""

    def __init__(self, *, required: bool) -> None:
        self.required = required
        self._changed: dict[Path, None] = {}

    @property
    def changed(self) -> tuple[str, ...]:
        """The files whose bytes differ from what was saved, in the order in which they were read."""
        return tuple(str(path) for path in self._changed)

    @property
    def notes(self) -> tuple[str, ...]:
        """One sentence about changed files for the user; empty if there are none."""
        if not self._changed:
            return ()
        first, *others = self.changed
        also = f" (and {len(others)} more)" if others else ""
        return (
            f"{first}{also}: not the bytes that were saved, by its checksum, and used all the same. "
            f"{_VERIFY}; {REQUIRED}=1 refuses such pictures",
        )

    def check(self, path: Path, data: bytes, sha256: str) -> None:
        """Compare an image's bytes with its checksum.

        Raises:
            IncompleteError: they differ, and checksums are required.
        """
        if hashlib.sha256(data).hexdigest() == sha256:
            return
        if self.required:
            raise IncompleteError(f"{path} is damaged: its checksum is not the session's", hint=_VERIFY)
        self._changed[path] = None


def picture_checks() -> PictureChecks:
    """Return the running command's checks; outside a command changed images are used."""
    return _checks.get(None) or PictureChecks(required=False)


def checked_pictures(*, required: bool | None = None) -> AbstractContextManager[PictureChecks]:
    """Check all images that are read within this context; None = refuse changed ones if `REQUIRED` is set."""
    if required is None:
        required = bool(os.environ.get(REQUIRED))
    return running(_checks, PictureChecks(required=required))


_checks: ContextVar[PictureChecks] = ContextVar("checks")
