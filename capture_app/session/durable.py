"""Files that are whole or not there: write aside, sync, rename, sync the folder."""

import os
from pathlib import Path

PART = ".part"
"""Ending of a file that is still being written; a reader never looks at one."""


def sync_folder(folder: Path) -> None:
    """Make the names in a folder survive a power cut."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file so that after a crash it is there in full or not at all; replaces an older one."""
    aside = path.with_name(path.name + PART)
    with aside.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    aside.replace(path)
    sync_folder(path.parent)


def make_folders(folder: Path, inside: Path) -> None:
    """Make `folder` and its parents below `inside`, each one synced into its parent."""
    if folder == inside or folder.is_dir():
        return
    make_folders(folder.parent, inside)
    folder.mkdir(exist_ok=True)
    sync_folder(folder.parent)


class AppendOnly:
    """A file of lines that only ever grows; a crash can tear its last line and no other."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("ab")

    def append(self, line: bytes, *, durable: bool) -> None:
        """Add one line (without its newline); `durable` waits until it is on the disk."""
        self._file.write(line + b"\n")
        self._file.flush()
        if durable:
            os.fdatasync(self._file.fileno())

    def close(self) -> None:
        """Sync and close. Calling it twice is harmless."""
        if not self._file.closed:
            os.fsync(self._file.fileno())
            self._file.close()
