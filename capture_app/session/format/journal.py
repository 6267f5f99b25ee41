"""The journal of a session: a line for each image that is safely on disk, and nothing but such lines."""

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import msgspec

from capture_app.session.files.durable import AppendOnlyFile, sync_folder

_T = TypeVar("_T")


@dataclass(slots=True)
class _Entry:
    line: bytes
    done: bool = False
    error: OSError | None = None


class Journal:
    """The journal file. Threads that add images at the same time share a sync of the disk."""

    def __init__(self, path: Path) -> None:
        self._file = AppendOnlyFile(path)
        self._waiting: list[_Entry] = []
        self._arriving = threading.Lock()
        self._syncing = threading.Lock()

    def note(self, line: bytes, folder: Path) -> None:
        """Return once the names in the image's folder, and then its line, are on the disk.

        Raises OSError; the line is then not in the journal.
        """
        sync_folder(folder)
        mine = _Entry(line)
        with self._arriving:
            self._waiting.append(mine)
        with self._syncing:
            # While this thread waited, the one before it may have added the line of this image with its own.
            if not mine.done:
                self._note_all()
        if mine.error is not None:
            raise mine.error

    def close(self) -> None:
        """Sync and close. Calling it twice is harmless."""
        self._file.close()

    def _note_all(self) -> None:
        with self._arriving:
            entries, self._waiting = self._waiting, []
        try:
            self._file.append(*(entry.line for entry in entries), durable=True)
        except OSError as error:
            for entry in entries:
                entry.error = error
        for entry in entries:
            entry.done = True


def record_of_line(line: bytes, kind: type[_T]) -> _T | None:
    """Read a line; None for one that a crash has torn or a fault has changed."""
    try:
        return msgspec.json.decode(line, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None


def lines_of_file(data: bytes) -> list[bytes]:
    """The lines of a journal file; what follows the last newline is a torn one."""
    lines = data.split(b"\n")
    return lines if lines[-1] else lines[:-1]
