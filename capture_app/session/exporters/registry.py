"""The formats by name, and the one way to export: into a folder that appears whole or not at all."""

import importlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import msgspec

from capture_app.errors import BadInputError, SimulshotError
from capture_app.session.exporters.common.burst import Burst, ExportOptions, Progress
from capture_app.session.exporters.formats import FORMATS
from capture_app.session.files.durable import PART, sync_folder
from capture_app.session.reading.reader import Session

Write = Callable[[Burst, Path, ExportOptions], list[str]]


class ExportReport(msgspec.Struct, frozen=True, kw_only=True):
    """What an export made: its folder, how many images the session has, and what a user should know."""

    folder: str
    format: str
    images: int
    notes: tuple[str, ...] = ()


def export_session(
    session: Session,
    name: str,
    out: Path,
    options: ExportOptions | None = None,
    progress: Progress = lambda done, total: None,
) -> ExportReport:
    """Export a session to the folder `out`, which must not exist or be empty.

    Raises BadInputError for an unknown format, a folder with content, or a session that cannot be
    exported so; IncompleteError where an image is missing; NotAvailableError where a package is.
    """
    if name not in FORMATS:
        raise BadInputError(f"no format {name!r}", hint=f"there are {', '.join(FORMATS)}")
    _check_place(session, out)
    write: Write = importlib.import_module(f"{__package__}.{name}").write
    burst = Burst(session, progress)
    aside = out.parent / f".{out.name}.{os.getpid()}{PART}"
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        aside.mkdir()
        try:
            notes = write(burst, aside, options or ExportOptions())
            _sync(aside)
            aside.rename(out)
        except BaseException:
            shutil.rmtree(aside, ignore_errors=True)
            raise
        sync_folder(out.parent)
    except OSError as error:
        what = f"cannot write {error.filename or out}: {error.strerror or error}"
        raise SimulshotError(what, hint="nothing was exported") from error
    return ExportReport(folder=str(out), format=name, images=len(burst.images), notes=(*burst.notes, *notes))


def _check_place(session: Session, out: Path) -> None:
    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise BadInputError(f"{out} is no folder", hint="name a folder that does not exist yet")
    if out.is_dir() and any(out.iterdir()):
        raise BadInputError(f"{out} has something in it already", hint="name a new or an empty folder")
    if out.resolve().is_relative_to(session.folder.resolve()):
        raise BadInputError(f"{out} lies inside the session", hint="export to a place of its own")


def _sync(folder: Path) -> None:
    for parent, _, files in os.walk(folder):
        for file in files:
            handle = os.open(Path(parent) / file, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)
        sync_folder(Path(parent))
