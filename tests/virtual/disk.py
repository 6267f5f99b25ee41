"""Disks of machines: slow, full, failing, and after a power cut without what was not synced.

The files are real, in memory where the system has a file system there; what a sync has made safe is
remembered apart: a file's bytes when it was synced, a folder's names when that was synced. A power cut leaves
these alone, which is the least that POSIX promises.
"""

import builtins
import contextlib
import errno
import io
import os
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from capture_app.session.files import durable
from tests.virtual.world import KilledError, Process, process

if TYPE_CHECKING:
    from tests.virtual.world import World

FREE_BYTES = 10 << 30


class Usage(NamedTuple):
    """As `shutil.disk_usage` returns it."""

    total: int
    used: int
    free: int


@dataclass
class Disk:
    """One machine's disk."""

    folder: Path
    mean_delay_s: float = 0.001
    is_full: bool = False
    is_failing: bool = False
    files: dict[int, bytes] = field(default_factory=dict)
    """Bytes that a power cut leaves, by inode."""
    names: dict[int, dict[str, int]] = field(default_factory=dict)
    """Names that a power cut leaves in a folder, by its inode."""
    folders: set[int] = field(default_factory=set)
    syncs_on_loop: list[str] = field(default_factory=list)
    """Files that were synced on an event loop, which stands still meanwhile."""


class Disks:
    """All machines' disks, below one temporary folder."""

    def __init__(self, world: "World") -> None:
        self.world = world
        memory = Path("/dev/shm")
        self.root = Path(
            tempfile.mkdtemp(prefix="virtual-", dir=memory if os.access(memory, os.W_OK) else None)
        )
        self._disks: dict[str, Disk] = {}
        self._open: dict[int, tuple[Process, Disk, str]] = {}
        self._chance: dict[str, Any] = {}
        self.kill_after: dict[Process, int] = {}
        """Steps of the disk after which a process is killed, in the middle of its work."""
        self.ignored_sync: Callable[[str], bool] = lambda _: False
        """Syncs that are forgotten, for a planted fault."""

    def of(self, machine: str) -> Disk:
        """Return a machine's disk."""
        if machine not in self._disks:
            folder = self.root / machine
            folder.mkdir()
            self._disks[machine] = Disk(folder)
            self._chance[machine] = self.world.chance("disk", machine)
        return self._disks[machine]

    def delay_s(self, machine: str) -> float:
        """Draw how long work in a thread takes, s."""
        disk = self.of(machine)
        return float(self._chance[machine].expovariate(1 / disk.mean_delay_s))

    def remove(self) -> None:
        """Delete all files."""
        shutil.rmtree(self.root, ignore_errors=True)

    def release(self, one: Process) -> None:
        """Close the files of a killed process, and with them its locks."""
        for number in [number for number, (owner, _, _) in self._open.items() if owner is one]:
            del self._open[number]
            with contextlib.suppress(OSError):
                _REAL.close(number)
        self.kill_after.pop(one, None)

    # Power

    def settle(self, machine: str) -> None:
        """Count everything on a disk as synced."""
        disk = self.of(machine)
        for parent, folders, files in os.walk(disk.folder):
            names = {}
            for name in (*folders, *files):
                path = Path(parent) / name
                names[name] = path.lstat().st_ino
                if name in files:
                    disk.files[names[name]] = path.read_bytes()
                else:
                    disk.folders.add(names[name])
            disk.names[Path(parent).stat().st_ino] = names

    def cut_power(self, machine: str) -> None:
        """Leave on a disk what was synced, and nothing else."""
        disk = self.of(machine)
        names, files, folders = disk.names, disk.files, disk.folders
        root = disk.folder.stat().st_ino
        for path in disk.folder.iterdir():
            shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()

        def restore(folder: Path, inode: int) -> None:
            for name, of in names.get(inode, {}).items():
                if of in folders or of in names:
                    (folder / name).mkdir()
                    restore(folder / name, of)
                else:
                    (folder / name).write_bytes(files.get(of, b""))

        restore(disk.folder, root)
        disk.names, disk.files, disk.folders = {}, {}, set()
        self.settle(machine)

    # The calls of the operating system

    def _step(self, disk: Disk, what: str) -> None:
        """Note a step of the disk by the running process; it may be its last."""
        owner = process.get()
        if owner is None:
            return
        if not owner.is_alive:
            raise KilledError
        if owner in self.kill_after:
            self.kill_after[owner] -= 1
            if self.kill_after[owner] <= 0:
                del self.kill_after[owner]
                self.world.note(owner.name, f"killed before {what}")
                owner.is_alive = False
                self.world.at(self.world.now_ns, lambda: self.world.on_end(owner, None))
                raise KilledError
        if disk.is_failing:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    def _disk_at(self, path: Any) -> Disk | None:
        text = os.fsdecode(path) if isinstance(path, str | bytes | os.PathLike) else ""
        start = f"{self.root}/"
        if not text.startswith(start):
            return None
        return self._disks.get(text[len(start) :].split("/", 1)[0])

    # In the place of the functions of `os`, `io` and `shutil`

    def _opened(self, path: Any, flags: int, *rest: Any, **options: Any) -> int:
        owner, disk = process.get(), self._disk_at(path)
        if disk is not None and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            self._step(disk, f"opening {_name(path)}")
        elif disk is not None:
            _check_alive()
        number = _REAL.open(path, flags, *rest, **options)
        if owner is not None and disk is not None:
            self._open[number] = (owner, disk, os.fsdecode(path))
        return number

    def _closed(self, number: int) -> None:
        owner = process.get()
        if owner is None or owner.is_alive or number in self._open:
            self._open.pop(number, None)
            _REAL.close(number)

    def _written(self, number: int, data: Any) -> int:
        if (known := self._open.get(number)) is None:
            _check_alive()
        else:
            _, disk, path = known
            self._step(disk, f"a write to {_name(path)}")
            if disk.is_full:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return _REAL.write(number, data)

    def _reserved(self, number: int, *_: int) -> None:
        """Reserve nothing, as a file system that cannot, unless the disk is full."""
        disk = self._disk_at(Path(f"/proc/self/fd/{number}").readlink())
        if disk is not None and disk.is_full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def _synced(self, number: int) -> None:
        if number not in self._open:
            _check_alive()
            return
        _, disk, path = self._open[number]
        self._step(disk, f"sync of {_name(path)}")
        short = path.removeprefix(f"{self.root}/")
        if not self.world.in_thread:
            disk.syncs_on_loop.append(short)
        if not self.ignored_sync(short):
            self._make_safe(disk, number)

    def _make_safe(self, disk: Disk, number: int) -> None:
        """Remember what a power cut leaves of an open file or folder from now on."""
        about = os.fstat(number)
        if stat.S_ISDIR(about.st_mode):
            with os.scandir(number) as entries:
                found = list(entries)
            disk.names[about.st_ino] = {entry.name: entry.inode() for entry in found}
            disk.folders.add(about.st_ino)
            disk.folders.update(entry.inode() for entry in found if entry.is_dir())
        else:
            disk.files[about.st_ino] = Path(f"/proc/self/fd/{number}").read_bytes()

    def _changing(self, name: str) -> Callable[..., Any]:
        """Return the function of `os` by that name, as a step of the disk."""
        real = getattr(_REAL, name)

        def change(path: Any, *rest: Any, **options: Any) -> Any:
            if (disk := self._disk_at(path)) is not None:
                self._step(disk, f"{name} of {_name(path)}")
            else:
                _check_alive()
            return real(path, *rest, **options)

        return change

    def _usage(self, path: Any) -> Usage:
        disk = self._disk_at(path)
        free = 0 if disk is not None and disk.is_full else FREE_BYTES
        return Usage(2 * FREE_BYTES, 2 * FREE_BYTES - free, free)

    def _opened_file(self, path: Any, mode: str = "r", *rest: Any, **options: Any) -> Any:
        if (mode[0] != "r" or "+" in mode) and (disk := self._disk_at(path)) is not None:
            self._step(disk, f"opening {_name(path)}")
        return _REAL.open_file(path, mode, *rest, **options)

    @contextlib.contextmanager
    def entered(self, replaced: Callable[..., None]) -> Iterator[None]:
        """Put the disks between processes and the system within the block."""
        replaced(
            os,
            open=self._opened,
            close=self._closed,
            write=self._written,
            fsync=self._synced,
            fdatasync=self._synced,
            posix_fallocate=self._reserved,
            **{name: self._changing(name) for name in _CHANGES},
        )
        replaced(io, open=self._opened_file)
        replaced(builtins, open=self._opened_file)
        replaced(shutil, disk_usage=self._usage)
        # Syncs in threads of their own would be real threads.
        replaced(durable, FEW_SYNCS=1 << 30)
        yield


_CHANGES = ("rename", "replace", "unlink", "remove", "mkdir", "rmdir")


class _REAL:
    """The system's own functions, taken before any is replaced."""

    open, close, write = os.open, os.close, os.write
    rename, replace, unlink, remove, mkdir, rmdir = (
        staticmethod(of) for of in (os.rename, os.replace, os.unlink, os.remove, os.mkdir, os.rmdir)
    )
    open_file: Any = staticmethod(io.open)


def _name(path: Any) -> str:
    return Path(os.fsdecode(path)).name


def _check_alive() -> None:
    """Raise KilledError in a process that was killed."""
    if (owner := process.get()) is not None and not owner.is_alive:
        raise KilledError
