"""What macOS does in another way than Linux, by Apple's manual pages; it has not been run on a Mac yet."""

import fcntl
import os
import threading
import time
from contextlib import suppress
from pathlib import Path

from capture_app.common.system.lacking import *  # noqa: F403
from capture_app.common.system.posix import *  # noqa: F403
from capture_app.common.system.posix import half_of_memory, plain_move

_F_FULLFSYNC = getattr(fcntl, "F_FULLFSYNC", 51)
_F_GETPATH, _MAX_PATH = getattr(fcntl, "F_GETPATH", 50), 1024
_LOOK_EVERY_S = 0.5


def sync_data(handle: int) -> None:
    """Make the contents of an open file survive a power cut. Raises OSError.

    fsync(2) of macOS leaves them in the drive's own memory; F_FULLFSYNC does not. A network's disk lacks it.
    """
    try:
        fcntl.fcntl(handle, _F_FULLFSYNC)
    except OSError:
        os.fsync(handle)


def asleep_ns() -> int:
    """Return for how long this machine has slept since its start, in ns; a slow call returns too little."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW) - time.monotonic_ns()


def path_of(handle: int) -> Path:
    """Return the present path of an open folder, or a path that does not exist."""
    with suppress(OSError):
        return Path(os.fsdecode(fcntl.fcntl(handle, _F_GETPATH, bytes(_MAX_PATH)).rstrip(b"\0")))
    return Path()


machine_memory = half_of_memory


move_new = plain_move


def hold_name(handle: int, name: str) -> None:
    """Do nothing: a disk without flock(2) has no locks here."""


def end_with_parent(parent: int) -> None:
    """End this process when the process that started it ends."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_LOOK_EVERY_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
