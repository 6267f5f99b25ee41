"""Exports a session in one of the formats, into a folder that appears whole or not at all."""

import importlib
from pathlib import Path

import msgspec

from capture_app.common.errors import BadInputError, SimulshotError
from capture_app.session.exchange import FORMATS, RECORD, ExportRecord, with_images_listed
from capture_app.session.exporters.common.exported_burst import ExportedBurst, ExportOptions, Progress
from capture_app.session.exporters.common.tables import write_frames
from capture_app.session.files.output_folder import OutputFolder, replaces_nothing
from capture_app.session.files.strangers import encode_checked, indented
from capture_app.session.reading.reader import Session

_ONLY_FOR = {
    "instant": ("colmap", "nerfstudio", "easyvolcap"),
    "points": ("colmap", "nerfstudio", "n3dv"),
    "masks": ("colmap", "nerfstudio", "easyvolcap"),
    "ros": ("mcap",),
}
"""Options that only some formats have a place for."""


class ExportReport(msgspec.Struct, frozen=True, kw_only=True):
    """The result of an export: its folder, the number of images in the session, and notes for the user."""

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
    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise BadInputError(f"{out} is not a folder", hint="name a folder that does not exist yet")
    if out.resolve().is_relative_to(session.folder.resolve()):
        raise BadInputError(f"{out} lies inside the session", hint="choose a folder outside it")
    output = OutputFolder(out, replaces_nothing)
    options = options or ExportOptions()
    for option, formats in _ONLY_FOR.items():
        if getattr(options, option) is not None and name not in formats:
            raise BadInputError(f"{name} takes no --{option}", hint=f"it is for {', '.join(formats)}")
    burst = ExportedBurst(session, options, progress)
    try:
        with output:
            importlib.import_module(f"{__package__}.{name}").write(burst, output.folder)
            write_frames(burst, output.folder)
            calibration = session.calibration()
            if calibration is not None:
                cameras = calibration.cameras | burst.drawn
                calibration = msgspec.structs.replace(calibration, cameras=cameras)
            manifest = with_images_listed(session.manifest)
            record = ExportRecord(format=name, manifest=manifest, calibration=calibration)
            (output.folder / RECORD).write_bytes(indented(encode_checked(record)))
    except OSError as error:
        raise SimulshotError(
            f"cannot write {error.filename or out}: {error.strerror or error}", hint="nothing was exported"
        ) from error
    return ExportReport(folder=str(out), format=name, images=len(burst.images), notes=tuple(burst.notes))
