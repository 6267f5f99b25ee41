"""Atomic and durable files: written to a temporary name, synced, renamed, and their folder synced."""

import ctypes
import errno
import os
import shutil
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import chain, count
from pathlib import Path

FEW_SYNCS, MOST_SYNCS = 2, 16
"""How few syncs are made one after the other, and how many at most at the same time."""
PART = ".part"
"""Ending of a file that is still being written; a reader never looks at one."""


def sync_folder(folder: Path) -> None:
    """Make the names in a folder survive a power cut."""
    _sync(folder, os.O_DIRECTORY)


def sync_tree(folder: Path) -> None:
    """Make a folder and all that is in it survive a power cut."""
    for parent, _, files in os.walk(folder):
        for path in (Path(parent) / file for file in files):
            if not path.is_symlink():
                _sync(path)
        sync_folder(Path(parent))


def sync_all(paths: Iterable[Path]) -> dict[Path, OSError]:
    """Make the contents of files, and the names in folders, survive a power cut; return what failed.

    All at once: a file system writes its own journal once for those that wait for it together.
    """
    errors: dict[Path, OSError] = {}

    def sync(path: Path) -> None:
        try:
            _sync(path)
        except OSError as error:
            errors[path] = error

    each = list(dict.fromkeys(paths))
    if len(each) <= FEW_SYNCS:
        for path in each:
            sync(path)
    else:
        with ThreadPoolExecutor(min(len(each), MOST_SYNCS), "sync") as threads:
            list(threads.map(sync, each))
    return errors


def _sync(path: Path, kind: int = 0) -> None:
    handle = os.open(path, os.O_RDONLY | kind)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def exchange_folders(one: Path, other: Path) -> bool:
    """Let two folders of one file system change places in a single step; False where the system cannot.

    Raises OSError. Linux' renameat2(2) with RENAME_EXCHANGE.
    """
    return _renameat2(one, other, 2)


def move_folder(folder: Path, target: Path) -> None:
    """Give a folder another name on its file system in a single step, durably, never in place of another.

    Raises FileExistsError where there is something at `target`; OSError. Linux' renameat2(2) with
    RENAME_NOREPLACE; a system without it can replace an empty folder that is made in the same moment.
    """
    if not _renameat2(folder, target, 1):
        if target.exists():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target))
        folder.rename(target)
    sync_folder(target.parent)
    sync_folder(folder.parent)


def _renameat2(one: Path, other: Path, how: int) -> bool:
    here = -100  # AT_FDCWD
    renameat2 = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if renameat2 is None:
        return False
    if renameat2(here, os.fsencode(one), here, os.fsencode(other), how) == 0:
        return True
    code = ctypes.get_errno()
    if code in (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP):
        return False
    raise OSError(code, os.strerror(code), str(other))


def free_name(path: Path) -> Path:
    """The path, or the first of NAME-2, NAME-3 ... that is not there yet."""
    numbered = (path.with_stem(f"{path.stem}-{number}") for number in count(2))
    return next(free for free in chain((path,), numbered) if not free.exists())


def write_atomic(path: Path, data: bytes) -> None:
    """Write a file so that after a crash it is there in full or not at all; replaces an older one."""
    _write_aside(path, data, synced=True)
    sync_folder(path.parent)


def write_unsynced(path: Path, data: bytes) -> None:
    """Write a file that a reader sees in full or not at all; file and folder are still to be synced."""
    _write_aside(path, data, synced=False)


def _write_aside(path: Path, data: bytes, *, synced: bool) -> None:
    aside = path.with_name(path.name + PART)
    try:
        handle = os.open(aside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o666)
        try:
            write_all(handle, data)
            if synced:
                os.fsync(handle)
        finally:
            os.close(handle)
        aside.replace(path)
    except OSError:
        # On a full disk the half that was written takes the room that something else could use.
        with suppress(OSError):
            aside.unlink()
        raise


def link_or_copy(source: str, target: str) -> None:
    """Let a second name point to a file's bytes; copy it where the file system has no links."""
    try:
        os.link(source, target, follow_symlinks=False)
    except OSError:
        shutil.copy2(source, target, follow_symlinks=False)


def make_folders(folder: Path, inside: Path) -> None:
    """Make `folder` and its parents below `inside`, each one synced into its parent."""
    for parent in make_folders_unsynced(folder, inside):
        sync_folder(parent)


def make_folders_unsynced(folder: Path, inside: Path) -> tuple[Path, ...]:
    """Do the same but for the syncs; return the folders that have new ones in them, the outermost first."""
    if folder == inside or folder.is_dir():
        return ()
    changed = make_folders_unsynced(folder.parent, inside)
    folder.mkdir(exist_ok=True)
    return (*changed, folder.parent)


def write_all(handle: int, data: bytes) -> None:
    """Write all of the data to an open file. Raises OSError."""
    left = memoryview(data)
    while left:
        left = left[os.write(handle, left) :]


class AppendOnlyFile:
    """A file of lines that only ever grows; a crash can tear its last lines and no other."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o666)
        self._length = os.fstat(self._handle).st_size
        self._open = True

    def append(self, *lines: bytes, durable: bool) -> None:
        """Add lines (without their newlines), all or none; `durable` waits until they are on the disk."""
        data = b"".join(line + b"\n" for line in lines)
        try:
            write_all(self._handle, data)
            if durable:
                os.fdatasync(self._handle)
        except OSError as error:
            # What is appended next must not continue half a line.
            with suppress(OSError):
                os.ftruncate(self._handle, self._length)
            raise OSError(error.errno, error.strerror, str(self._path)) from error
        self._length += len(data)

    def close(self) -> None:
        """Close, whatever the disk says: what must be on it was synced before. Twice is harmless."""
        if self._open:
            self._open = False
            with suppress(OSError):
                os.close(self._handle)
