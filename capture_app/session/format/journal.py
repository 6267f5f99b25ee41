"""The journal of a session: a line for each image that is safely on disk, and nothing but such lines."""

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import msgspec

from capture_app.session.files.durable import AppendOnlyFile, sync_all
from capture_app.text import UNREADABLE

_T = TypeVar("_T")


@dataclass(slots=True)
class JournalEntry:
    """A line, and the files and folders that must be on the disk before it."""

    line: bytes
    paths: tuple[Path, ...]
    done: bool = False
    error: OSError | None = None
    """Why the line is not in the journal."""


class Journal:
    """The journal file. Images that are added while the disk is being synced share the next sync."""

    def __init__(self, path: Path) -> None:
        self._file = AppendOnlyFile(path)
        self._waiting: list[JournalEntry] = []
        self._arriving = threading.Lock()
        self._syncing = threading.Lock()

    def note(self, entries: Sequence[JournalEntry]) -> None:
        """Return once the entries' files, and then their lines, are on the disk, or have an error."""
        with self._arriving:
            self._waiting.extend(entries)
        with self._syncing:
            # While this thread waited, the one before it may have noted these entries with its own.
            if not all(entry.done for entry in entries):
                self._note_all()

    def close(self) -> None:
        """Close. Calling it twice is harmless."""
        # Each line was synced when it was added.
        self._file.close(synced=False)

    def _note_all(self) -> None:
        with self._arriving:
            entries, self._waiting = self._waiting, []
        failed = sync_all(path for entry in entries for path in entry.paths)
        for entry in entries:
            entry.error = next((failed[path] for path in entry.paths if path in failed), None)
        good = [entry for entry in entries if entry.error is None]
        try:
            if good:
                self._file.append(*(entry.line for entry in good), durable=True)
        except OSError as error:
            for entry in good:
                entry.error = error
        for entry in entries:
            entry.done = True


def record_of_line(line: bytes, kind: type[_T]) -> _T | None:
    """Read a line; None for one that a crash has torn or a fault has changed."""
    try:
        return msgspec.json.decode(line, type=kind)
    except UNREADABLE:
        return None


def lines_of_file(data: bytes) -> list[bytes]:
    """The lines of a journal file; what follows the last newline is a torn one."""
    lines = data.split(b"\n")
    return lines if lines[-1] else lines[:-1]
