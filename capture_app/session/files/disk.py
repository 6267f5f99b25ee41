"""Room on the disk: reserving it, noticing that there is none, and errors in words."""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from capture_app.common.errors import BadInputError, DiskError, DiskFullError

LITTLE_BYTES = 1 << 20
"""With less than this on a disk, a write that failed without a reason failed for want of room."""
SPARE_BYTES = 2 << 20
"""What is to stay free on a disk beside the images of a burst."""


def make_new_folder(folder: Path) -> None:
    """Make a folder and its parents; raises BadInputError if it exists or cannot be made; DiskFullError."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir()
    except FileExistsError:
        raise BadInputError(f"{folder} exists already", hint="choose another name") from None
    except OSError as error:
        if is_full(error):
            raise disk_error(error, folder) from error
        raise BadInputError(f"cannot make {folder}: {error.strerror}") from error


def reserve(path: Path, size: int) -> None:
    """Reserve `size` bytes of the disk in an empty file. Raises OSError where there is not so much room."""
    with path.open("wb") as file:
        try:
            os.posix_fallocate(file.fileno(), 0, size)
        except OSError as error:
            path.unlink()
            # Some file systems cannot promise room; then a full disk costs the manifest, which repair writes.
            if is_full(error):
                raise


def free_bytes(folder: Path) -> int:
    """What is free for this user on the disk of a folder, which need not be there yet, in bytes.

    Raises DiskError where the disk does not answer.
    """
    try:
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
        return shutil.disk_usage(folder).free
    except OSError as error:
        raise disk_error(error, folder) from error


def is_full(error: OSError, folder: Path | None = None, little_bytes: int = LITTLE_BYTES) -> bool:
    """Whether an error means that there is no room left, on the disk or in the user's share of it.

    With the `folder` that was written to, also if its disk has next to no room: some errors give no reason.
    """
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return True
    return folder is not None and folder.is_dir() and shutil.disk_usage(folder).free < little_bytes


def disk_error(error: OSError, folder: Path) -> DiskError:
    """An error of the disk in words."""
    if is_full(error):
        what = f"the disk of {folder} is full"
        return DiskFullError(what, hint="what was saved before is intact; make room, and it can go on")
    where = error.filename or folder
    return DiskError(f"cannot write {where}: {error.strerror}", hint="what was saved before is intact")


@contextmanager
def disk_errors(folder: Path) -> Iterator[None]:
    """Raise DiskError, or DiskFullError, where what is written in that folder, or read, raises OSError."""
    try:
        yield
    except OSError as error:
        raise disk_error(error, folder) from error
