"""Locks between processes, which the system releases when their holder exits or is killed.

They are flock's. On a file system without it (NFS without lockd, WSL 1, some Lustre) and on Windows they are
names, which keep out the processes of this machine only.
"""

import os
import time
from pathlib import Path

from capture_app.common import system
from capture_app.common.errors import TryAgainError, reading
from capture_app.common.file_system_limits import is_missing
from capture_app.session.files.durable import make_folders

_TRIES = 5
_READER_S = 0.005


def lock_handle(handle: int, *, wait: bool = False, shared: bool = False) -> os.stat_result:
    """Lock an open file or folder until its handle is closed; return its status.

    Where the file system has no locks, the handle becomes the one of a held name. Raises BlockingIOError if
    another process holds the lock and `wait` is not set; OSError.
    """
    status = os.fstat(handle)
    try:
        system.flock(handle, shared=shared, wait=wait)
        return status
    except OSError as error:
        if not is_missing("flock", error.errno):
            raise
    while True:
        try:
            system.hold_name(handle, f"simulshot-lock-{status.st_dev}-{status.st_ino}")
            return status
        except BlockingIOError:
            if not wait:
                raise
        time.sleep(_READER_S)


def lock_folder(folder: Path) -> int:
    """Lock a session's folder against other writers. Raises TryAgainError if it is locked already."""
    with reading(folder):
        handle = system.open_folder(folder)
    for _ in range(_TRIES):
        try:
            locked = lock_handle(handle)
            # The folder may have been moved meanwhile, and another may have taken its name.
            if os.path.samestat(locked, folder.stat()):
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
            handle = system.open_file(path, os.O_RDWR | os.O_CREAT)
        except FileNotFoundError:
            continue  # the previous holder has just removed the folder
        try:
            locked = lock_handle(handle, wait=wait)
            if os.path.samestat(locked, path.stat()):
                return handle
        except FileNotFoundError:
            pass
        except BaseException:
            os.close(handle)
            raise
        # The locked file was deleted meanwhile, so other processes lock a different one.
        os.close(handle)
