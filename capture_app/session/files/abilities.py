"""What the file system of a folder lacks, tried with a hidden folder in it."""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from capture_app.common import system
from capture_app.common.file_system_limits import is_missing


def missing_abilities(folder: Path) -> list[str]:
    """Return what a writable folder's file system lacks, and what follows, in sentences. Raises OSError."""
    with tempfile.TemporaryDirectory(prefix=".simulshot-", dir=folder) as name:
        file = Path(name) / "file"
        file.touch()
        handle = system.open_folder(Path(name))
        tries: tuple[tuple[str, str, Callable[[], object]], ...] = (
            (
                "fsync",
                "folders cannot be synced: a power cut may lose the newest files",
                lambda: system.sync_path(Path(name)),
            ),
            (
                "flock",
                "no locks: one machine may use it at a time",
                lambda: system.flock(handle),
            ),
            (
                "link",
                "no hard links: renaming a session copies its images",
                lambda: os.link(file, file.with_name("link")),
            ),
            (
                "chmod",
                "no permissions: everybody who reaches it reads the sessions",
                lambda: file.chmod(0o600),
            ),
        )
        try:
            # No disk of Windows has such locks: there it is no fault of this one.
            return [
                lack
                for call, lack, attempt in tries
                if (call != "flock" or os.name == "posix") and _is_missing(call, attempt)
            ]
        finally:
            os.close(handle)


def _is_missing(call: str, attempt: Callable[[], object]) -> bool:
    try:
        attempt()
    except OSError as error:
        if not is_missing(call, error.errno):
            raise
        return True
    return False
