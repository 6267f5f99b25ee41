"""The trash of a folder of sessions: a deleted session can be restored until the trash is emptied.

ROOT/.trash/<id>/trashed.json    its original location, on disk before the session is moved
ROOT/.trash/<id>/session         the session, unchanged
ROOT/.trash/<id>/results         the results made from it, if any
"""

import os
import shutil
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import msgspec
from msgspec import Struct

from capture_app.common.errors import BadInputError, IncompleteError
from capture_app.common.names import check_name
from capture_app.session.files.disk import disk_error, disk_errors
from capture_app.session.files.durable import free_name, make_folders, move_folder, sync_folder, write_atomic
from capture_app.session.files.locks import lock_folder
from capture_app.session.files.untrusted_files import encode_checked, indented, read_struct
from capture_app.session.format.burst_plan import PLAN
from capture_app.session.format.manifest import JOURNAL, MANIFEST
from capture_app.session.library.changes import move_result_folder, rename_session, results_folder

TRASH = ".trash"
_RECORD, _SESSION, _RESULTS = "trashed.json", "session", "results"


class TrashedSession(Struct, frozen=True, kw_only=True):
    """One session in the trash."""

    id: str
    """Name of the session's folder in the trash, which identifies it when it is restored."""
    name: str
    """Name of its folder before it was deleted."""
    trashed: str
    """When it was deleted; RFC 3339, UTC."""


def trash_session(folder: Path) -> TrashedSession:
    """Move a complete, interrupted or damaged session and its results into the trash beside it.

    Raises BadInputError if it is not a session or cannot be moved, TryAgainError if it is being written.
    """
    folder = folder.absolute()
    if not any((folder / name).is_file() for name in (MANIFEST, JOURNAL, PLAN)):
        raise BadInputError(f"no session at {folder}", hint="capture-app sessions list shows what is there")
    lock = lock_folder(folder)
    try:
        trash = folder.parent / TRASH
        make_folders(trash, folder.parent)
        entry = free_name(trash / folder.name)
        entry.mkdir()
        now = datetime.now(UTC).isoformat().replace("+00:00", "Z")
        trashed = TrashedSession(id=entry.name, name=folder.name, trashed=now)
        # The original location is stored first: a crash in between leaves the session in place.
        write_atomic(entry / _RECORD, indented(encode_checked(trashed)))
        sync_folder(trash)
        move_folder(folder, entry / _SESSION)
        move_result_folder(results_folder(folder), entry / _RESULTS)
    except OSError as error:
        raise disk_error(error, folder) from error
    finally:
        os.close(lock)
    return trashed


def trashed_sessions(root: Path) -> list[TrashedSession]:
    """Return the contents of the trash of a folder of sessions, the latest last."""
    found = []
    for session in sorted((root / TRASH).glob(f"*/{_SESSION}/")):
        entry = session.parent
        # A lost record costs the deletion time only: the entry is named after the session.
        trashed = TrashedSession(id=entry.name, name=entry.name, trashed="")
        with suppress(BadInputError):
            trashed = msgspec.structs.replace(read_struct(entry / _RECORD, TrashedSession), id=entry.name)
        found.append(trashed)
    return sorted(found, key=lambda one: one.trashed)


def restore_session(root: Path, which: str = "", *, name: str = "") -> Path:
    """Move a session from the trash back to its original place, and return its folder.

    `which` is its id or name there, by default the latest one; `name` is a new folder name for it. Raises
    BadInputError if there is no such session, or the name is in use.
    """
    found = [one for one in trashed_sessions(root) if not which or which in (one.id, one.name)]
    if not found:
        what = f"no session {which} in the trash of {root}" if which else f"the trash of {root} is empty"
        raise BadInputError(what, hint=f"capture-app sessions list --trash {root}")
    chosen = next((one for one in found if one.id == which), found[-1])
    entry = root / TRASH / chosen.id
    target = root / (check_name(name, "session") if name else Path(chosen.name).name)
    try:
        move_folder(entry / _SESSION, target)
    except FileExistsError:
        raise BadInputError(f"{target} exists already", hint="restore it with --as NAME") from None
    except OSError as error:
        raise disk_error(error, target) from error
    move_result_folder(entry / _RESULTS, results_folder(target))
    shutil.rmtree(entry, ignore_errors=True)
    if name:
        # An interrupted or damaged session keeps its internal name.
        with suppress(BadInputError, IncompleteError):
            rename_session(target, name)
    return target


def empty_trash(root: Path) -> int:
    """Delete everything in the trash for good, and return the number of sessions. Raises SimulshotError."""
    sessions = len(trashed_sessions(root))
    with disk_errors(root / TRASH), suppress(FileNotFoundError):
        shutil.rmtree(root / TRASH)
    return sessions
