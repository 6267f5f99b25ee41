"""Disk space: reserving it, detecting a full disk, and disk errors as messages."""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from capture_app.common.errors import BadInputError, DiskError, DiskFullError

LITTLE_BYTES = 1 << 20
"""Free space below which a write error without a reason counts as a full disk, bytes."""
SPARE_BYTES = 2 << 20
"""Free space to leave on a disk besides the images of a burst, bytes."""


def make_new_folder(folder: Path) -> None:
    """Create a folder and its parents.

    Raises BadInputError if it exists or cannot be created; DiskFullError.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir()
    except FileExistsError:
        raise BadInputError(f"{folder} exists already", hint="choose another name") from None
    except OSError as error:
        if is_full(error):
            raise disk_error(error, folder) from error
        raise BadInputError(
            f"cannot make {folder}: {error.strerror}", hint="choose a folder that you may write to"
        ) from error


def reserve(path: Path, size: int) -> None:
    """Reserve `size` bytes of disk space in an empty file. Raises OSError if there is not enough."""
    with path.open("wb") as file:
        try:
            # Other systems than Linux have no such call: zeros reserve as well.
            getattr(os, "posix_fallocate", lambda *_: file.write(bytes(size)))(file.fileno(), 0, size)
        except OSError as error:
            path.unlink()
            # Some file systems cannot reserve space; then a full disk costs the manifest, which repair
            # writes.
            if is_full(error):
                raise


def free_bytes(folder: Path) -> int:
    """Return the disk space available to this user, in bytes; `folder` need not exist yet.

    Raises DiskError if the disk does not respond.
    """
    with disk_errors(folder):
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
        return shutil.disk_usage(folder).free


def is_full(error: OSError, folder: Path | None = None, little_bytes: int = LITTLE_BYTES) -> bool:
    """Return whether an error means that the disk, or the user's quota, is full.

    Given the `folder` of the write, a nearly full disk counts too: some errors state no reason.
    """
    return error.errno in (errno.ENOSPC, errno.EDQUOT) or (
        folder is not None and folder.is_dir() and shutil.disk_usage(folder).free < little_bytes
    )


def disk_error(error: OSError, folder: Path) -> DiskError:
    """Convert an OSError of the disk into a message for users."""
    if is_full(error):
        return DiskFullError(
            f"the disk of {folder} is full",
            hint="what was saved before is intact; make room, and it can go on;"
            " a disk with space left may hold too many files",
        )
    return DiskError(
        f"cannot write {error.filename or folder}: {error.strerror or error}",
        hint="check the disk: capture-app doctor; what was saved before is intact",
    )


@contextmanager
def disk_errors(folder: Path) -> Iterator[None]:
    """Raise DiskError or DiskFullError when reading or writing in that folder raises OSError."""
    try:
        yield
    except OSError as error:
        raise disk_error(error, folder) from error
