"""What Windows does in another way: files that others may replace, locks by name, processes, timers.

Files are opened by CreateFile with all kinds of sharing, so that an open file can be renamed and deleted, as
the rest of simulshot expects. Constants are from Microsoft's headers.
"""

import _winapi
import asyncio
import ctypes
import errno
import msvcrt
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any

import psutil

from capture_app.common.system.every import *  # noqa: F403
from capture_app.common.system.every import NO_LIMIT, Received
from capture_app.common.system.lacking import *  # noqa: F403

PYTHON = (getattr(sys, "_base_executable", sys.executable),)
"""Command line of this interpreter; a virtual environment's python.exe starts it as a child of its own."""
assert sys.platform == "win32"  # type checkers look at it for Windows only

_FROM_STATE = {os.O_RDONLY: 0x80000000, os.O_WRONLY: 0x40000000, os.O_RDWR: 0xC0000000}
_HOW = {0: 3, os.O_CREAT: 4, os.O_CREAT | os.O_EXCL: 1, os.O_CREAT | os.O_TRUNC: 2}
_SHARED, _NORMAL, _FOLDER = 7, 0x80, 0x02000000
"""FILE_SHARE_READ, _WRITE and _DELETE; FILE_ATTRIBUTE_NORMAL; FILE_FLAG_BACKUP_SEMANTICS."""
_HELD = (5, 231)
"""ERROR_ACCESS_DENIED, ERROR_PIPE_BUSY."""
_ACTS: dict[str, Callable[[psutil.Process], None]] = {
    "end": psutil.Process.resume,
    "kill": psutil.Process.kill,
    "pause": psutil.Process.suspend,
    "resume": psutil.Process.resume,
}
_PAUSES_S = (0.001, 0.005, 0.02, 0.1, 0.3)
"""A virus scanner or an indexer holds a new file for moments."""
_CLOSING = 2
"""CTRL_CLOSE_EVENT; codes of a session's or the system's end are greater, of keys less."""
_TO_CLOSE_S = 4.5
"""Windows ends a process 5 s after its window was closed."""
_kernel = ctypes.WinDLL("kernel32", use_last_error=True)
_kernel.GetTickCount64.restype = ctypes.c_uint64
ctypes.WinDLL("winmm").timeBeginPeriod(1)

monotonic_ns = time.perf_counter_ns
"""Returns the clock of this machine that never steps, in ns: QueryPerformanceCounter.

Before Python 3.13, `time.monotonic` counts in ticks of 15.6 ms here.
"""
monotonic_s = time.perf_counter
"""Returns `monotonic_ns` in seconds."""


def asleep_ns() -> int:
    """Return for how long this machine has slept since its start, in ns, to some 20 ms."""
    awake = ctypes.c_uint64()
    _kernel.QueryUnbiasedInterruptTime(ctypes.byref(awake))
    return int(_kernel.GetTickCount64()) * 1_000_000 - awake.value * 100


class new_event_loop(asyncio.ProactorEventLoop):  # noqa: N801 - a function on other systems
    """Event loop by `monotonic_s`: by Python's own clock its timers are up to 15.6 ms early or late."""

    def __init__(self) -> None:
        super().__init__()
        self._clock_resolution = 1e-6

    time = staticmethod(monotonic_s)


def open_file(path: str | Path, flags: int, *, mode: int = 0o666, follow_links: bool = True) -> int:
    """Open a file in binary as `os.open`; children do not inherit the handle.

    Others may rename and delete the file meanwhile. Raises OSError, also for a link if not `follow_links`.
    """
    if not follow_links and Path(path).is_symlink():
        raise OSError(errno.ELOOP, "it is a link", str(path))
    how = _HOW[flags & (os.O_CREAT | os.O_EXCL | os.O_TRUNC)]
    return _open(path, _FROM_STATE[flags & 3], how, _NORMAL, flags & (os.O_APPEND | os.O_RDONLY))


def open_folder(path: Path) -> int:
    """Open a folder, to lock it. Raises OSError."""
    return _open(path, 0x80000000, 3, _FOLDER, os.O_RDONLY)


def path_of(handle: int) -> Path:
    """Return a path that does not exist: a folder in which files are open cannot be renamed."""
    return Path()


def _open(path: str | Path, access: int, how: int, attributes: int, flags: int) -> int:
    try:
        opened = _winapi.CreateFile(str(path), access, _SHARED, 0, how, attributes, 0)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path), error.winerror) from None
    return msvcrt.open_osfhandle(opened, flags | os.O_BINARY | os.O_NOINHERIT)


def read_at(handle: int, size: int, offset: int) -> bytes:
    """Return up to `size` bytes of an open file from `offset` on."""
    os.lseek(handle, offset, os.SEEK_SET)
    return os.read(handle, size)


sync_data = os.fsync
"""Takes the handle of an open file, and makes its contents survive a power cut. Raises OSError."""


def sync_path(path: Path) -> None:
    """Make a file's contents survive a power cut. Raises OSError.

    NTFS writes names to its own journal, and Windows cannot sync a folder.
    """
    if not path.is_dir():
        with open(open_file(path, os.O_RDWR), "r+b") as file:
            os.fsync(file.fileno())


def replace(source: Path, target: Path, rename: Callable[[Path, Path], object] = Path.replace) -> None:
    """Rename a file atomically, in the place of an older one. Raises OSError."""
    for pause_s in _PAUSES_S:
        with suppress(PermissionError):
            rename(source, target)
            return
        time.sleep(pause_s)
    rename(source, target)


def move_new(source: Path, target: Path) -> None:
    """Rename a file or folder atomically where nothing has that name. Raises FileExistsError; OSError."""
    replace(source, target, Path.rename)


def flock(handle: int, *, shared: bool = False, wait: bool = False) -> None:
    """Raise OSError: Windows locks no folders, and of files only parts; see `hold_name`."""
    raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))


def hold_name(handle: int, name: str) -> None:
    """Hold a name on this machine until an open handle, which then is a pipe's, is closed.

    Raises BlockingIOError if another process holds the name; OSError.
    """
    first_only = 0x3 | 0x80000  # PIPE_ACCESS_DUPLEX, FILE_FLAG_FIRST_PIPE_INSTANCE
    try:
        pipe = _winapi.CreateNamedPipe(rf"\\.\pipe\{name}", first_only, 0, 1, 0, 0, 0, 0)
    except OSError as error:
        if error.winerror not in _HELD:
            raise
        raise BlockingIOError(errno.EWOULDBLOCK, os.strerror(errno.EWOULDBLOCK)) from error
    named = msvcrt.open_osfhandle(pipe, os.O_RDWR | os.O_BINARY | os.O_NOINHERIT)
    os.dup2(named, handle, inheritable=False)
    os.close(named)


def receive_datagrams(
    sock: socket.socket, max_bytes: int, received: Received, drained: Callable[[], None], *, at_once: int
) -> Callable[[], object]:
    """Pass on the datagrams of a UDP socket in the running loop; return what ends that.

    Windows stamps none: a thread of its own does, as soon as one can be read. At most `at_once` wait for the
    loop.
    """
    loop, ended, room = asyncio.get_running_loop(), threading.Event(), threading.Semaphore(at_once)
    sock.setblocking(True)
    with suppress(OSError):  # it is bound already
        sock.bind(("::" if sock.family == socket.AF_INET6 else "", 0))

    def receive() -> None:
        while not ended.is_set():
            try:
                data, address = sock.recvfrom(max_bytes)
            except OSError:
                continue  # an ICMP error: something was sent to a closed port; or this one is closed
            stamp_ns = monotonic_ns()
            room.acquire()
            with suppress(RuntimeError):  # the loop is closed
                loop.call_soon_threadsafe(pass_on, data, (address[0], address[1]), stamp_ns)

    def pass_on(data: bytes, address: tuple[str, int], stamp_ns: int) -> None:
        room.release()
        if not ended.is_set():
            received(data, address, None, stamp_ns)

    threading.Thread(target=receive, daemon=True, name="datagrams").start()
    return ended.set


def watch_input(said: Callable[[bytes], object]) -> None:
    """Pass on what standard input gives, in the running loop, until its end, which is b""."""
    loop = asyncio.get_running_loop()

    def read() -> None:
        handle, data = msvcrt.get_osfhandle(sys.stdin.fileno()), b"-"
        while data:
            try:
                data, _ = _winapi.ReadFile(handle, 4096)
            except OSError:  # the other end of the pipe is closed
                data = b""
            with suppress(RuntimeError):  # the loop is closed
                loop.call_soon_threadsafe(said, data)

    threading.Thread(target=read, daemon=True, name="input").start()


def on_end(end: Callable[[], object]) -> None:
    """Call `end` in the running loop at Ctrl-Break, and when the console's window or the session closes."""
    loop = asyncio.get_running_loop()
    signal.signal(signal.SIGBREAK, lambda *_: loop.call_soon_threadsafe(end))

    def closing(event: int) -> int:
        if event >= _CLOSING:
            loop.call_soon_threadsafe(end)
            time.sleep(_TO_CLOSE_S)  # the process is ended as soon as this returns
        return 0

    _handlers.append(ctypes.WINFUNCTYPE(ctypes.c_int, ctypes.c_uint)(closing))
    _kernel.SetConsoleCtrlHandler(_handlers[-1], 1)


_handlers: list[Any] = []
"""Functions that the system calls, which must not be freed."""


interrupts_blocked = nullcontext
"""Does nothing: Ctrl-C reaches all processes of a console."""


def child_options(variables: Mapping[str, str], *, in_background: bool = False) -> dict[str, Any]:
    """Return the arguments of `subprocess.Popen` for a process in a group of its own.

    `variables` are added to its environment. One `in_background` outlives the console; the others share it,
    so that `signal_group` reaches them.
    """
    flags = subprocess.CREATE_NEW_PROCESS_GROUP | (subprocess.CREATE_NO_WINDOW if in_background else 0)
    # By the second variable, the interpreter of PYTHON finds the packages of the virtual environment.
    variables = {**os.environ, "PYTHONUTF8": "1", "__PYVENV_LAUNCHER__": sys.executable, **variables}
    return {"creationflags": flags, "env": variables}


is_running = psutil.pid_exists
"""Takes a process's number, and returns whether it runs on this machine, also another user's."""


def signal_group(pid: int, what: str) -> None:
    """Have a process and its children end, also while they pause; kill, pause or resume them.

    `what` is one of these words. Raises ProcessLookupError if it has ended.
    """
    try:
        process = psutil.Process(pid)
        every = [process, *process.children(recursive=True)]
    except psutil.Error as error:
        raise ProcessLookupError(errno.ESRCH, os.strerror(errno.ESRCH)) from error
    for one in every:
        with suppress(psutil.Error):
            _ACTS[what](one)
    if what == "end":
        with suppress(OSError):  # it has another console, or none, and will be killed
            os.kill(pid, signal.CTRL_BREAK_EVENT)


def end_with_parent(parent: int) -> None:
    """End this process when the process that started it ends."""

    def watch() -> None:
        with suppress(OSError):  # it has ended already
            handle = _winapi.OpenProcess(0x100000, False, parent)  # SYNCHRONIZE
            _winapi.WaitForSingleObject(handle, _winapi.INFINITE)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def lower_priority(niceness: int) -> None:
    """Run this process at a lower priority."""
    psutil.Process().nice(psutil.BELOW_NORMAL_PRIORITY_CLASS if niceness else psutil.NORMAL_PRIORITY_CLASS)


def machine_memory() -> int:
    """Return the memory that is free, in bytes."""
    return int(psutil.virtual_memory().available)


def address_space() -> int:
    """Return NO_LIMIT: Windows sets none for a process."""
    return NO_LIMIT


def allow_open_files(count: int) -> int:
    """Return NO_LIMIT: Windows does not limit a process's files and sockets."""
    return NO_LIMIT
