"""Locks between processes (flock), which the system releases when their holder ends or is killed."""

import fcntl
import os
import time
from pathlib import Path

from capture_app.common.errors import BadInputError, TryAgainError
from capture_app.session.files.durable import make_folders

_TRIES = 5
_READER_S = 0.005


def lock_folder(folder: Path) -> int:
    """Lock a session's folder against other writers. Raises TryAgainError where one has it already."""
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise BadInputError(f"cannot open {folder}: {error.strerror}") from error
    for _ in range(_TRIES):
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # A folder that was moved meanwhile is not the one that has this name now.
            if os.path.samestat(os.fstat(handle), folder.stat()):
                return handle
            break
        except FileNotFoundError:
            break
        except BlockingIOError:
            # Nobody but a writer holds it for long: a reader only looks whether it is held.
            time.sleep(_READER_S)
    os.close(handle)
    raise TryAgainError(f"{folder} is being written by another process")


def lock_file(path: Path, *, wait: bool = False) -> int:
    """Lock a file, which is made with its folder where it is not there, and return its open handle.

    Whoever holds the lock may delete the file and its folder. Raises BlockingIOError where another process
    holds it, unless `wait` is set; OSError.
    """
    while True:
        make_folders(path.parent, Path(path.anchor))
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except FileNotFoundError:
            continue  # the one who held the lock has removed the folder just now
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            if os.path.samestat(os.fstat(handle), path.stat()):
                return handle
        except FileNotFoundError:
            pass
        except BaseException:
            os.close(handle)
            raise
        # The file that was locked here is not the one that others lock: it was deleted meanwhile.
        os.close(handle)
