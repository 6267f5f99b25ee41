"""Locks between processes (flock), which the system releases when their holder exits or is killed."""

import fcntl
import os
import time
from pathlib import Path

from capture_app.common.errors import TryAgainError, reading
from capture_app.session.files.durable import make_folders

_TRIES = 5
_READER_S = 0.005


def lock_folder(folder: Path) -> int:
    """Lock a session's folder against other writers. Raises TryAgainError if it is locked already."""
    with reading(folder):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    for _ in range(_TRIES):
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # The folder may have been moved meanwhile, and another may have taken its name.
            if os.path.samestat(os.fstat(handle), folder.stat()):
                return handle
            break
        except FileNotFoundError:
            break
        except BlockingIOError:
            # Only a writer holds it for long: a reader just tests the lock.
            time.sleep(_READER_S)
    os.close(handle)
    raise TryAgainError(
        f"{folder} is being written by another process", hint="wait until that process is finished"
    )


def lock_file(path: Path, *, wait: bool = False) -> int:
    """Lock a file, created with its folder if missing, and return its open handle.

    The lock's holder may delete the file and its folder. Raises BlockingIOError if another process holds the
    lock and `wait` is not set; OSError.
    """
    while True:
        make_folders(path.parent, Path(path.anchor))
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except FileNotFoundError:
            continue  # the previous holder has just removed the folder
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            if os.path.samestat(os.fstat(handle), path.stat()):
                return handle
        except FileNotFoundError:
            pass
        except BaseException:
            os.close(handle)
            raise
        # The locked file was deleted meanwhile, so other processes lock a different one.
        os.close(handle)
