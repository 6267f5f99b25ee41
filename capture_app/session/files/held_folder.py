"""A folder as an open, locked handle: a person may rename or move it while it is written."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from capture_app.common import system
from capture_app.common.errors import TryAgainError
from capture_app.session.files.disk import disk_error
from capture_app.session.files.locks import lock_folder


class HeldFolder:
    """A folder that this process writes, locked against others until `close`.

    On Windows it cannot be renamed meanwhile: files in it are open.
    """

    def __init__(self, path: Path) -> None:
        """Lock the folder at a path. Raises TryAgainError if it is locked already, BadInputError, OSError."""
        self._first = self._path = path
        self._handle = lock_folder(path)
        self._status = path.stat()

    @property
    def path(self) -> Path:
        """The folder's path at present; once it is deleted, the last one."""
        is_elsewhere = self._handle >= 0 and not self._is_at(self._path)
        if is_elsewhere and self._is_at(moved := system.path_of(self._handle)):
            self._path = moved
        return self._path

    @property
    def moved_to(self) -> Path | None:
        """Where it was found last, if that isn't where it was first; it does not look at the disk."""
        return None if self._path == self._first else self._path

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Raise DiskError when writing raises OSError; TryAgainError if the folder was renamed meanwhile."""
        before = self.path
        try:
            yield
        except OSError as error:
            if self.path != before:
                raise TryAgainError(f"{before} was renamed: it is {self.path} now") from error
            raise disk_error(error, before) from error

    def close(self) -> None:
        """Release the lock; from then on the path is no longer followed."""
        os.close(self._handle)
        # Another folder may get the number of this handle, and of a deleted folder.
        self._handle = -1

    def _is_at(self, path: Path) -> bool:
        with suppress(OSError):
            return os.path.samestat(self._status, path.stat())
        return False
