"""What Linux has beside POSIX: atomic exchange, names of sockets, free memory, signals at a parent's end."""

import ctypes
import errno
import fcntl
import os
import re
import signal
import socket
import struct
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

from capture_app.common.file_system_limits import is_missing
from capture_app.common.system.posix import *  # noqa: F403
from capture_app.common.system.posix import half_of_memory, plain_move

_SIOCGIWPOWER = 0x8B2D
_REQUEST = struct.Struct("@16siBBH8x")
"""`struct iwreq` with its `struct iw_param` (<linux/wireless.h>)."""
_EXCLUSIVELY, _EXCHANGING = 1, 2
"""RENAME_NOREPLACE and RENAME_EXCHANGE of renameat2(2)."""
_MAX_HEAPS, _MAX_FREED, _MIN_MAPPED = -8, -1, -3
"""M_ARENA_MAX, M_TRIM_THRESHOLD and M_MMAP_THRESHOLD of glibc's malloc.h."""
_REUSED_BYTES = 32 << 20
"""The largest M_MMAP_THRESHOLD that glibc takes."""


def sync_data(handle: int) -> None:
    """Make the contents of an open file survive a power cut. Raises OSError."""
    getattr(os, "fdatasync", os.fsync)(handle)


def path_of(handle: int) -> Path:
    """Return the present path of an open folder, or a path that does not exist."""
    with suppress(OSError):
        return Path(f"/proc/self/fd/{handle}").readlink()
    return Path()


def exchange(path: Path, other: Path) -> bool:
    """Swap two files or folders of one file system atomically; return False if the system cannot do it.

    Raises OSError.
    """
    return _renameat2(path, other, _EXCHANGING)


def move_new(source: Path, target: Path) -> None:
    """Rename a file or folder atomically where nothing has that name. Raises FileExistsError; OSError.

    A file system without such a call does it as `plain_move`.
    """
    if not _renameat2(source, target, _EXCLUSIVELY):
        plain_move(source, target)


def _renameat2(path: Path, other: Path, how: int) -> bool:
    here = -100  # AT_FDCWD
    renameat2 = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if renameat2 is None:
        return False
    if renameat2(here, os.fsencode(path), here, os.fsencode(other), how) == 0:
        return True
    code = ctypes.get_errno()
    if is_missing("renameat2", code):
        return False
    raise OSError(code, os.strerror(code), str(other))


def hold_name(handle: int, name: str) -> None:
    """Hold a name on this machine until an open handle, which then is another one, is closed.

    Raises BlockingIOError if another process holds the name; OSError.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as named:
        try:
            named.bind(f"\0{name}")
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            raise BlockingIOError(errno.EWOULDBLOCK, os.strerror(errno.EWOULDBLOCK)) from error
        os.dup2(named.fileno(), handle, inheritable=False)


def end_with_parent(parent: int) -> None:
    """Have this process killed, even a paused one, when the process that started it ends."""
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
    if os.getppid() != parent:  # it has ended already
        sys.exit(1)


def raise_thread_priority() -> None:
    """Raise the calling thread's priority, which threads that it begins inherit, if the system permits it."""
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), -10)


def asleep_ns() -> int:
    """Return for how long this machine has slept since its start, in ns; a slow call returns too little."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.monotonic_ns()


def machine_memory() -> int:
    """Return the memory that is free, in bytes, or half of the machine's where that is not known."""
    with suppress(OSError):
        if matched := re.search(
            r"^MemAvailable: +(\d+)", Path("/proc/meminfo").read_text(encoding="utf-8"), re.MULTILINE
        ):
            return int(matched[1]) << 10
    return half_of_memory()


def limit_heaps(heaps: int) -> None:
    """Let this process's threads share so many heaps, before any thread starts; only glibc has several.

    By default every new thread gets its own, up to eight a core, and each holds what was freed in it.
    """
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).mallopt(_MAX_HEAPS, heaps)


def reuse_freed_memory() -> None:
    """Let this process reuse up to 32 MB that it has freed for its next images; only glibc returns so much.

    By default, the memory of an image may be returned when it is freed, and cleared anew for the next one.
    """
    with suppress(AttributeError, OSError):
        for threshold in (_MAX_FREED, _MIN_MAPPED):
            ctypes.CDLL(None).mallopt(threshold, _REUSED_BYTES)


def saves_power(interface: str) -> bool | None:
    """Return whether a WiFi interface saves power; None if its driver does not report it."""
    request = _REQUEST.pack(interface.encode()[:15], 0, 0, 0, 0)
    with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        _, _, _, disabled, _ = _REQUEST.unpack(fcntl.ioctl(probe, _SIOCGIWPOWER, request))
        return not disabled
    return None
