"""Session export to one of the formats, into a folder that appears complete or not at all.

Only this module checks an export's requirements, which its `Exporter` declares.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from capture_app.common.errors import BadInputError
from capture_app.common.optional_packages import load_optional
from capture_app.common.text import Progress
from capture_app.session.exporting.csv_tables import write_frames
from capture_app.session.exporting.exported_burst import ExportedBurst
from capture_app.session.exporting.exporter import (
    Exporter,
    load_exporter,
    load_exporters,
    own_options,
)
from capture_app.session.files.output_folder import OutputFolder, replaces_nothing
from capture_app.session.files.untrusted_files import encode_checked, indented
from capture_app.session.format.calibration import METRES, Calibration
from capture_app.session.format.calibration_judge import check_lens
from capture_app.session.format.export_record import RECORD, ExportRecord, with_images_listed
from capture_app.session.format.manifest import CALIBRATION
from capture_app.session.reading.reader import Session


def export_session(
    session: Session,
    name: str,
    out: Path,
    progress: Progress = lambda done, total: None,
    on_warning: Callable[[str], None] = lambda note: None,
    *,
    link: bool = False,
    lossless: bool = False,
    **options: Any,
) -> ExportedBurst:
    """Export a session to the folder `out`, which must be empty or not exist, and return what was exported.

    `link` hard-links image files where possible instead of copying them, `lossless` writes videos and redrawn
    images losslessly; further `options` are the format's. `on_warning` gets notes on what the program
    cannot use well before they are written. Raises BadInputError for an unknown format
    or option, a folder with content, or a session that the format cannot hold; IncompleteError for a missing
    image; NotAvailableError for a missing package; DiskFullError, OSError.
    """
    exporter = load_exporter(name)
    if out.resolve().is_relative_to(session.folder.resolve()):
        raise BadInputError(f"{out} is inside the session", hint="choose a folder outside it")
    output = OutputFolder(out, replaces_nothing)
    _check_options(name, exporter, options)
    burst = ExportedBurst(session, progress, options.get("instant"), link=link, lossless=lossless)
    burst.on_warning = on_warning
    if session.manifest.is_staggered:
        burst.warn(f"the session is staggered: {session.manifest.steps} between frames of one instant")
    _check_needs(exporter, burst, options)
    with output:
        chosen = {option: value for option, value in options.items() if option != "instant"}
        exporter.write(burst, output.folder, **chosen)
        write_frames(burst, output.folder)
        calibration = session.calibration()
        record = ExportRecord(
            format=name,
            manifest=with_images_listed(session.manifest),
            calibration=calibration and replace(calibration, cameras=calibration.cameras | burst.drawn),
        )
        (output.folder / RECORD).write_bytes(indented(encode_checked(record)))
    return burst


def _check_options(name: str, exporter: Exporter, given: dict[str, Any]) -> None:
    own = own_options(exporter)
    if unknown := [option for option in given if option not in own]:
        formats = ", ".join(
            other for other, exporter in load_exporters().items() if unknown[0] in own_options(exporter)
        )
        raise BadInputError(f"{name} takes no --{unknown[0]}", hint=formats and f"it is for {formats}")


def _check_needs(exporter: Exporter, burst: ExportedBurst, given: dict[str, Any]) -> None:
    """Check an exporter's requirements, and load the burst's calibration if it reads one.

    Raises BadInputError or NotAvailableError if a requirement is missing.
    """
    own = own_options(exporter)
    instead = (own[option][1].packages for option in given if option in own)
    for module, extra in next(filter(None, instead), exporter.packages).items():
        load_optional(module, extra, f"an export for {exporter.program}")
    if exporter.complete_instants and not burst.complete_instants():
        raise BadInputError(
            f"{burst.session.folder}: no instant has an image of every camera, "
            f"which {exporter.program} needs",
            hint="export to another format, such as --to mp4, or take another burst",
        )
    calibration = burst.session.calibration()
    if exporter.calibration == "unused":
        return
    if calibration is not None:
        _check_calibration(exporter, burst, calibration)
        burst.calibration = calibration
    elif exporter.calibration == "required":
        raise BadInputError(
            f"{burst.session.folder} has no calibration, which {exporter.program} needs",
            hint=f"run reconstruct calibrate, or put a {CALIBRATION} into the session",
        )
    elif exporter.uncalibrated:
        burst.notes.append(exporter.uncalibrated)


def _check_calibration(exporter: Exporter, burst: ExportedBurst, calibration: Calibration) -> None:
    """Check that all cameras are calibrated at their image size; add a note if the unit is not a length."""
    for camera in burst.cameras:
        where = f"{burst.session.folder / CALIBRATION}: {camera}"
        if camera not in calibration.cameras:
            raise BadInputError(
                f"{where} is not calibrated, which {exporter.program} needs",
                hint=f"reconstruct calibrate {burst.session.folder}",
            )
        lens, (width, height) = calibration.cameras[camera], burst.size(camera)
        if (lens.width, lens.height) != (width, height):
            raise BadInputError(
                f"{where} is calibrated for {lens.width}x{lens.height} pixels, "
                f"but its images are {width}x{height}",
                hint=f"reconstruct calibrate {burst.session.folder}",
            )
        check_lens(where, lens)
        if lens.is_fisheye and not exporter.fisheyes:
            raise BadInputError(
                f"{where} is a fisheye, which the export to {exporter.program} cannot have",
                hint="export to splats, which redraws the images, or to colmap or nerfstudio",
            )
    if exporter.unit and calibration.unit not in METRES:
        burst.notes.append(
            f"the calibration is in {calibration.unit!r}; it is written as if that were {exporter.unit}"
        )
