"""What Linux and macOS have in common; each call that one of them lacks is looked up when it is used."""

import asyncio
import errno
import fcntl
import os
import resource
import signal
import socket
import struct
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from capture_app.common.system.every import *  # noqa: F403
from capture_app.common.system.every import NO_LIMIT, Received

PYTHON = (sys.executable,)
"""Command line of this interpreter, which a child process begins with."""
SO_TIMESTAMPNS = 35
"""Linux's number of the socket option, which the socket module lacks."""
_SIGNALS = {
    "end": (signal.SIGTERM, signal.SIGCONT),
    "kill": (signal.SIGKILL,),
    "pause": (signal.SIGSTOP,),
    "resume": (signal.SIGCONT,),
}
_TIMESPEC = struct.Struct("@ll")
_ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size)


monotonic_ns = time.monotonic_ns
"""Returns the clock of this machine that never steps, in ns: the one by which drivers stamp frames."""
monotonic_s = time.monotonic
"""Returns `monotonic_ns` in seconds."""
new_event_loop = asyncio.new_event_loop
"""Returns an event loop whose timers are accurate to a millisecond."""


def open_file(path: str | Path, flags: int, *, mode: int = 0o666, follow_links: bool = True) -> int:
    """Open a file in binary as `os.open`, without waiting for a pipe; children do not inherit the handle.

    Others may rename and delete the file meanwhile. Raises OSError, also for a link if not `follow_links`.
    """
    return os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC | (0 if follow_links else os.O_NOFOLLOW), mode)


def open_folder(path: Path) -> int:
    """Open a folder, to lock it. Raises OSError."""
    return os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)


read_at = os.pread
"""Takes a handle, a size and an offset, and returns that part of an open file, in several threads at once."""


def sync_path(path: Path) -> None:
    """Make a file's contents, or the names in a folder, survive a power cut. Raises OSError."""
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def replace(source: Path, target: Path) -> None:
    """Rename a file atomically, in the place of an older one. Raises OSError."""
    source.replace(target)


def flock(handle: int, *, shared: bool = False, wait: bool = False) -> None:
    """Lock an open file or folder until its handle is closed. Raises BlockingIOError; OSError."""
    fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB))


def receive_datagrams(
    sock: socket.socket, max_bytes: int, received: Received, drained: Callable[[], None], *, at_once: int
) -> Callable[[], object]:
    """Pass on the datagrams of a non-blocking UDP socket in the running loop; return what ends that.

    `drained` is called when none is left. At most `at_once` come in one turn of the loop, so that a flood
    does not keep others waiting. Linux stamps each datagram when it arrives.
    """
    with suppress(OSError):
        sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)

    def readable() -> None:
        for _ in range(at_once):
            try:
                data, ancillary, _, address = sock.recvmsg(max_bytes, _ANCILLARY_BYTES)
            except BlockingIOError:
                drained()
                return
            except OSError:
                continue  # an ICMP error: something was sent to a closed port, or a datagram closed this one
            stamps = [stamp for _, kind, stamp in ancillary if kind == SO_TIMESTAMPNS]
            seconds, nanoseconds = _TIMESPEC.unpack(stamps[0]) if stamps else (0, 0)
            received(data, address[:2], seconds * 1_000_000_000 + nanoseconds or None, None)

    loop = asyncio.get_running_loop()
    handle = sock.fileno()
    loop.add_reader(handle, readable)
    return lambda: loop.remove_reader(handle)


def watch_input(said: Callable[[bytes], object]) -> None:
    """Pass on what standard input gives, in the running loop, until its end, which is b"".

    A terminal is read only while this process is in its foreground: it would be stopped otherwise.
    """
    loop, handle = asyncio.get_running_loop(), sys.stdin.fileno()

    def readable() -> None:
        is_behind = os.isatty(handle) and os.tcgetpgrp(handle) != os.getpgrp()
        data = b"" if is_behind else os.read(handle, 4096)
        if not data:
            loop.remove_reader(handle)
        said(data)

    loop.add_reader(handle, readable)


def on_end(end: Callable[[], object]) -> None:
    """Call `end` in the running loop when this process is asked to end, or its terminal closes.

    A terminal over SSH may close: the process ends in order then; under nohup it goes on.
    """
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) != signal.SIG_IGN:
            with suppress(NotImplementedError):  # a loop outside the main thread
                asyncio.get_running_loop().add_signal_handler(number, end)
    resume = signal.getsignal(signal.SIGCONT)
    if callable(resume):
        # A terminal that closes sends it, too: the screen would write to it by a thread that dies at once.
        signal.signal(signal.SIGCONT, lambda *about: resume(*about) if os.isatty(0) else None)


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Start no thread or process within the block that handles Ctrl-C: they inherit that."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def child_options(variables: Mapping[str, str], *, in_background: bool = False) -> dict[str, Any]:
    """Return the arguments of `subprocess.Popen` for a process in a group of its own.

    `variables` are added to its environment. One `in_background` outlives the terminal.
    """
    return {"start_new_session": True, "env": {**os.environ, **variables}}


def is_running(pid: int) -> bool:
    """Return whether a process runs on this machine, also another user's."""
    try:
        os.kill(pid, 0)
    except (OSError, OverflowError) as error:
        return isinstance(error, PermissionError)
    return True


def signal_group(pid: int, what: str) -> None:
    """Have the group of a process end, also while it pauses; kill, pause or resume it.

    `what` is one of these words. Raises ProcessLookupError if it has ended.
    """
    for number in _SIGNALS[what]:
        os.killpg(pid, number)


def lower_priority(niceness: int) -> None:
    """Run this process at a lower priority, even if it has inherited a higher one."""
    os.nice(max(0, niceness - os.nice(0)))


def plain_move(source: Path, target: Path) -> None:
    """Rename a file or folder where nothing has that name. Raises FileExistsError; OSError.

    It can replace an empty folder that is created at the same moment.
    """
    if target.exists():
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target))
    source.rename(target)


def half_of_memory() -> int:
    """Return half of this machine's memory, in bytes."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2


def address_space() -> int:
    """Return the limit of this process's address space, in bytes, or NO_LIMIT."""
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return NO_LIMIT if limit == resource.RLIM_INFINITY else limit


def allow_open_files(count: int) -> int:
    """Raise this process's limit of open files and sockets, and return the limit."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= soft < count:
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (min(count, hard % NO_LIMIT), hard))
    return resource.getrlimit(resource.RLIMIT_NOFILE)[0] % NO_LIMIT
