"""Sessions for tests that change them: written durably for the first test, and copied for the others."""

from collections.abc import Callable
from pathlib import Path

from capture_app.session.reading.reader import Session

_trees: dict[str, list[tuple[Path, int, bytes | None]]] = {}
"""Relative path, mode and bytes of all files and folders, by what was asked for; no bytes are a folder."""


def written_once(what: str, folder: Path, write: Callable[[], Session]) -> Session:
    """Return the session that `write` writes into a folder; `what` tells it from others."""
    if what not in _trees:
        session = write()
        _trees[what] = [
            (path.relative_to(folder), path.stat().st_mode, path.read_bytes() if path.is_file() else None)
            for path in sorted(folder.rglob("*"))
        ]
        return session
    folder.mkdir(parents=True)
    for path, mode, data in _trees[what]:
        if data is None:
            (folder / path).mkdir()
        else:
            (folder / path).write_bytes(data)
        (folder / path).chmod(mode & 0o777)
    return Session.open(folder)
