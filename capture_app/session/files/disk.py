"""A session's disk: the folder's lock, room that is kept free, and its errors in words."""

import errno
import fcntl
import os
from pathlib import Path

from capture_app.errors import BadInputError, DiskFullError, SimulshotError, TryAgainError


def lock_folder(folder: Path) -> int:
    """Lock a session's folder against other writers. Raises TryAgainError where one has it already."""
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise BadInputError(f"cannot open {folder}: {error.strerror}") from error
    try:
        # A reader asks for the lock only once there is a journal, so nothing but a writer can hold it.
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise TryAgainError(f"{folder} is being written by another process") from None
    return handle


def reserve(path: Path, size: int) -> None:
    """Keep `size` bytes of the disk in a file of nothing. Raises OSError where there is not so much room."""
    with path.open("wb") as file:
        try:
            os.posix_fallocate(file.fileno(), 0, size)
        except OSError as error:
            path.unlink()
            # Some file systems cannot promise room; then a full disk costs the manifest, which repair writes.
            if is_full(error):
                raise


def is_full(error: OSError) -> bool:
    """Whether an error means that there is no room left, on the disk or in the user's share of it."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT)


def disk_error(error: OSError, folder: Path) -> SimulshotError:
    """An error of the disk in words."""
    if is_full(error):
        what = f"the disk of {folder} is full"
        return DiskFullError(what, hint="what was saved before is intact; make room, and it can go on")
    where = error.filename or folder
    return SimulshotError(f"cannot write {where}: {error.strerror}", hint="what was saved before is intact")
