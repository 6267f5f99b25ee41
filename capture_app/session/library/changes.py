"""Changes of a finished session: rename, annotate, delete and restore; and where its results are.

    ROOT/_results/<session>/<kind>        a result of `reconstruct`
    ROOT/_results/<session>/<kind>.log    its log
    ROOT/.trash/<id>/trashed.json         a deleted session's original place, on disk before it is moved
    ROOT/.trash/<id>/session              the session, unchanged
    ROOT/.trash/<id>/results              the results made from it, if any

No session can be called `_results` or `.trash`: names begin with a letter or a digit.
"""

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path

import msgspec
from msgspec import UNSET, Struct, UnsetType, structs

from capture_app.common.errors import BadInputError, DiskError, IncompleteError
from capture_app.common.names import check_name, typed_name
from capture_app.session.files.disk import disk_error, disk_errors
from capture_app.session.files.durable import (
    copy_tree,
    free_name,
    make_folders,
    move_folder,
    sync_folder,
    write_atomic,
)
from capture_app.session.files.locks import lock_folder
from capture_app.session.files.output_folder import OutputFolder
from capture_app.session.files.untrusted_files import encode_checked, indented, read_struct
from capture_app.session.format.burst_plan import PLAN, read_plan
from capture_app.session.format.manifest import JOURNAL, MANIFEST, Manifest
from capture_app.session.reading.checksums import CHECKSUMS, changed_files
from capture_app.session.reading.reader import Session, no_session

RESULTS = "_results"
MAX_NOTE = 1000
"""Maximum length of a note, characters."""
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")
TRASH = ".trash"
_RECORD, _SESSION, _OWN_RESULTS = "trashed.json", "session", "results"
"""Names in a deleted session's folder of the trash."""


def results_folder(session: Path, root: Path | None = None) -> Path:
    """Return the folder for the results made from a session.

    `root` is the user's folder of sessions. Results of a session from elsewhere, such as a bundled sample, go
    there too, since its own folder may be read-only or belong to another program.
    """
    root = session.parent if root is None else root
    elsewhere = session.parent.resolve() != root.resolve()
    return root / RESULTS / (f"_{session.parent.name}" if elsewhere else "") / session.name


def move_result_folder(folder: Path, target: Path) -> None:
    """Move a folder of results to `target`, replacing leftovers there; on an error it stays where it is."""
    with suppress(OSError):
        if folder.is_dir():
            shutil.rmtree(target, ignore_errors=True)
            target.parent.mkdir(parents=True, exist_ok=True)
            move_folder(folder, target)


def rename_session(folder: Path, name: str) -> Path:
    """Rename a session: its folder, and its name in the manifest and the plan; return the new folder.

    A crash leaves it complete under one of the two names, and the same call then finishes the work. Raises
    BadInputError for an invalid name, one in use, or a session that is damaged or cannot be changed;
    IncompleteError; TryAgainError if another process is writing it.
    """
    name, folder = typed_name(name, "session"), folder.absolute()
    target = folder.with_name(name)
    if target != folder and (target.exists() or target.is_symlink()):
        raise BadInputError(f"{target} exists already", hint="choose another name")
    with _changeable(folder, name=name, label=UNSET):
        if target != folder:
            _move(folder, target, hint="choose another name")
            move_result_folder(results_folder(folder), results_folder(target))
    return target


def _move(folder: Path, target: Path, hint: str) -> None:
    try:
        move_folder(folder, target)
    except FileExistsError:
        raise BadInputError(f"{target} exists already", hint=hint) from None
    except OSError as error:
        raise disk_error(error, folder) from error


def check_note(note: str) -> None:
    """Raise BadInputError for a note of several lines or more than `MAX_NOTE` characters."""
    if _CONTROL.search(note):
        raise BadInputError("a note is one line without control characters", hint="leave out line ends")
    if len(note) > MAX_NOTE:
        raise BadInputError(f"the note has {len(note)} characters", hint=f"at most {MAX_NOTE} fit")


def set_note(folder: Path, note: str) -> None:
    """Replace the note of a session: one line of text, which may be empty.

    Raises BadInputError for a note that `check_note` rejects, or a session that is damaged; IncompleteError;
    TryAgainError if another process is writing it.
    """
    check_note(note)
    with _changeable(folder.absolute(), note=note):
        pass


@contextmanager
def _changeable(folder: Path, **changed: str | UnsetType) -> Iterator[None]:
    """Lock a session, atomically replace it by one with these manifest fields, and hold the lock.

    The new folder shares the files of the old one, so that manifest, plan and checksums change together.
    """
    before = Session.open(folder).stored_manifest
    locks = [lock_folder(folder)]
    try:
        damaged = [name for name, _ in changed_files(folder) if name in (MANIFEST, PLAN, CHECKSUMS)]
        if damaged and (folder / CHECKSUMS).exists():
            raise BadInputError(
                f"{folder / damaged[0]} has changed since it was saved",
                hint=f"first: capture-app sessions repair {folder}",
            )
        after = structs.replace(before, **changed)
        if after != before:
            with OutputFolder(folder, lambda _: None) as output:
                locks.append(lock_folder(output.folder))
                copy_tree(folder, output.folder)
                _write_changed(output.folder, after)
        yield
    except PermissionError as error:
        raise BadInputError(
            f"cannot read all of {folder}: {error}",
            hint="check the permissions of its files; the session is unchanged",
        ) from error
    finally:
        for lock in locks:
            os.close(lock)


def _write_changed(folder: Path, manifest: Manifest) -> None:
    """Write manifest and plan, and their lines of the checksums; other lines stay unchanged."""
    written = {MANIFEST: indented(msgspec.json.encode(manifest, enc_hook=tuple))}
    if (folder / PLAN).is_file():
        plan = structs.replace(read_plan(folder), name=manifest.name, note=manifest.note)
        written[PLAN] = indented(msgspec.json.encode(plan))
    for name, data in written.items():
        write_atomic(folder / name, data)
    if (folder / CHECKSUMS).is_file():
        lines = (folder / CHECKSUMS).read_bytes().splitlines(keepends=True)
        named = ((line.decode("ascii", errors="replace").partition("  ")[2].strip(), line) for line in lines)
        renewed = (
            f"{sha256(written[name]).hexdigest()}  {name}\n".encode() if name in written else line
            for name, line in named
        )
        write_atomic(folder / CHECKSUMS, b"".join(renewed))


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
        raise no_session(folder)
    with ExitStack() as held, disk_errors(folder):
        held.callback(os.close, lock_folder(folder))
        trash = folder.parent / TRASH
        make_folders(trash, folder.parent)
        entry = free_name(trash / folder.name)
        entry.mkdir()
        trashed = TrashedSession(
            id=entry.name, name=folder.name, trashed=datetime.now(UTC).isoformat().replace("+00:00", "Z")
        )
        # The original location is stored first: a crash in between leaves the session in place.
        write_atomic(entry / _RECORD, indented(encode_checked(trashed)))
        sync_folder(trash)
        move_folder(folder, entry / _SESSION)
        move_result_folder(results_folder(folder), entry / _OWN_RESULTS)
    return trashed


def trashed_sessions(root: Path) -> list[TrashedSession]:
    """Return the contents of the trash of a folder of sessions, the latest last."""
    sessions = []
    for entry in (session.parent for session in sorted((root / TRASH).glob(f"*/{_SESSION}/"))):
        # A lost record costs the deletion time only: the entry is named after the session.
        trashed = TrashedSession(id=entry.name, name=entry.name, trashed="")
        with suppress(BadInputError):
            trashed = msgspec.structs.replace(read_struct(entry / _RECORD, TrashedSession), id=entry.name)
        sessions.append(trashed)
    return sorted(sessions, key=lambda session: session.trashed)


def restore_session(root: Path, which: str = "", *, name: str = "") -> Path:
    """Move a session from the trash back to its original place, and return its folder.

    `which` is its id or name there, by default the latest one; `name` is a new folder name for it. Raises
    BadInputError if there is no such session, or the name is in use.
    """
    matches = [
        session for session in trashed_sessions(root) if not which or which in (session.id, session.name)
    ]
    if not matches:
        raise BadInputError(
            f"no session {which} in the trash of {root}" if which else f"the trash of {root} is empty",
            hint=f"capture-app sessions list --trash {root}",
        )
    chosen = next((session for session in matches if session.id == which), matches[-1])
    entry = root / TRASH / chosen.id
    target = root / (check_name(name, "session") if name else Path(chosen.name).name)
    _move(entry / _SESSION, target, hint="restore it with --as NAME")
    move_result_folder(entry / _OWN_RESULTS, results_folder(target))
    shutil.rmtree(entry, ignore_errors=True)
    if name:
        # An interrupted or damaged session keeps its internal name.
        with suppress(BadInputError, IncompleteError):
            rename_session(target, name)
    return target


def empty_trash(root: Path) -> int:
    """Delete everything in the trash for good, and return the number of sessions. Raises SimulshotError."""
    sessions = len(trashed_sessions(root))
    if (root / TRASH).is_symlink():
        raise DiskError(
            f"{root / TRASH} is a symbolic link, and nothing behind it is deleted",
            hint="delete the link, or the sessions where it leads",
        )
    with disk_errors(root / TRASH), suppress(FileNotFoundError):
        shutil.rmtree(root / TRASH)
    return sessions
