"""Atomic and durable files: write to a temporary name, sync, rename, and sync the folder."""

import os
import shutil
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import chain, count
from pathlib import Path

from capture_app.common import system
from capture_app.common.file_system_limits import is_missing

FEW_SYNCS, MAX_SYNCS = 2, 16
"""Number of syncs up to which they run sequentially, and maximum number of concurrent syncs."""
PART = ".part"
"""Suffix of a file that is still being written; readers ignore such files."""


def sync_folder(folder: Path) -> None:
    """Make the names in a folder survive a power cut."""
    _sync(folder)


def sync_tree(folder: Path) -> None:
    """Make a folder and everything in it survive a power cut."""
    for parent, _, files in os.walk(folder):
        for path in (Path(parent) / file for file in files):
            if not path.is_symlink():
                _sync(path)
        sync_folder(Path(parent))


def sync_all(paths: Iterable[Path]) -> dict[Path, OSError]:
    """Make the contents of files, and the names in folders, survive a power cut; return the errors by path.

    The syncs run concurrently: the file system then commits its journal once for all of them.
    """

    def sync(path: Path) -> OSError | None:
        try:
            _sync(path)
        except OSError as error:
            return error
        return None

    each = list(dict.fromkeys(paths))
    with ThreadPoolExecutor(MAX_SYNCS, "sync") as threads:
        errors = (threads.map if len(each) > FEW_SYNCS else map)(sync, each)
        return {path: error for path, error in zip(each, errors, strict=True) if error is not None}


def _sync(path: Path) -> None:
    try:
        system.sync_path(path)
    except OSError as error:
        if not is_missing("fsync", error.errno) or not path.is_dir():
            raise


def move_folder(folder: Path, target: Path) -> None:
    """Rename a folder on its file system atomically and durably, without replacing another.

    Raises FileExistsError if `target` exists; OSError.
    """
    system.move_new(folder, target)
    sync_folder(target.parent)
    sync_folder(folder.parent)


def free_name(path: Path) -> Path:
    """Return the path, or the first of NAME-2, NAME-3 ... that does not exist."""
    numbered = (path.with_stem(f"{path.stem}-{number}") for number in count(2))
    return next(free for free in chain((path,), numbered) if not free.exists())


def write_atomic(path: Path, data: bytes | memoryview, *, synced: bool = True) -> None:
    """Write a file that readers see in full or not at all, also after a crash; replaces an older one.

    Without `synced`, the caller syncs the file and its folder.
    """
    aside = path.with_name(path.name + PART)
    try:
        handle = system.open_file(aside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        try:
            write_all(handle, data)
            if synced:
                system.sync_data(handle)
        finally:
            os.close(handle)
        system.replace(aside, path)
    except OSError:
        # On a full disk the partial file would occupy space that other files need.
        with suppress(OSError):
            aside.unlink()
        raise
    if synced:
        sync_folder(path.parent)


def link_or_copy(source: str, target: str) -> None:
    """Create a hard link to a file; copy it if the file system does not support links."""
    try:
        os.link(source, target, follow_symlinks=False)
    except OSError:
        shutil.copyfile(source, target, follow_symlinks=False)
        _copy_modes(source, target)


def copy_tree(folder: Path, target: Path) -> None:
    """Copy a folder, with hard links to its files, into a new or an existing one. Raises OSError."""
    target.mkdir(exist_ok=True)
    for path in folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            copy_tree(path, target / path.name)
        else:
            link_or_copy(str(path), str(target / path.name))
    _copy_modes(folder, target)


def _copy_modes(source: str | Path, target: str | Path) -> None:
    """Copy permissions and times, where the file system has them."""
    with suppress(OSError):
        shutil.copystat(source, target, follow_symlinks=False)


def make_folders(folder: Path, inside: Path) -> None:
    """Create `folder` and its parents below `inside`, each synced into its parent."""
    for parent in make_folders_unsynced(folder, inside):
        sync_folder(parent)


def make_folders_unsynced(folder: Path, inside: Path) -> tuple[Path, ...]:
    """Create `folder` and its parents without syncs; return the folders with new entries, outermost first."""
    if folder == inside or folder.is_dir():
        return ()
    changed = make_folders_unsynced(folder.parent, inside)
    folder.mkdir(exist_ok=True)
    return (*changed, folder.parent)


def write_all(handle: int, data: bytes | memoryview) -> None:
    """Write all of the data to an open file. Raises OSError."""
    left = memoryview(data)
    while left:
        left = left[os.write(handle, left) :]


class AppendOnlyFile:
    """An append-only file of lines; a crash can only tear the lines being appended."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._handle = system.open_file(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        self._length = os.fstat(self._handle).st_size

    def append(self, *lines: bytes, durable: bool) -> None:
        """Append lines (without newlines), all or none; with `durable`, wait until they are on disk."""
        data = b"".join(line + b"\n" for line in lines)
        try:
            if os.fstat(self._handle).st_size > self._length:
                # A failing disk did not remove what it had not written completely.
                os.ftruncate(self._handle, self._length)
            write_all(self._handle, data)
            if durable:
                system.sync_data(self._handle)
        except OSError as error:
            # Later lines must not continue a partial one.
            with suppress(OSError):
                os.ftruncate(self._handle, self._length)
            raise OSError(error.errno, error.strerror, str(self._path)) from error
        self._length += len(data)

    def close(self) -> None:
        """Close the file and ignore disk errors: durable lines are synced already. May be called twice."""
        handle, self._handle = self._handle, -1
        with suppress(OSError):
            os.close(handle)
