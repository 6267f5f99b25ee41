"""simulshot's own files: an export is read as its original session, and a session as a calibration."""

from collections.abc import Sequence
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.common.names import IMAGE_SUFFIXES, VIDEO_SUFFIXES
from capture_app.session.files.untrusted_files import read_struct
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.export_record import FRAMES, RECORD, read_record
from capture_app.session.format.manifest import CALIBRATION
from capture_app.session.importing.exported_session import Place, exported_files, exported_layout
from capture_app.session.importing.importer import Importer
from capture_app.session.importing.recording_sources import Images, Layout, Source, Video
from capture_app.session.importing.views import Views, read_json


def open_recording(path: Path, *, png: bool, recording: str | None) -> Layout | None:
    """Open the folder of an export. Raises BadInputError if its records are malformed."""
    return _open_export(path, png) if (path / RECORD).is_file() else None


def _open_export(folder: Path, png: bool) -> Layout:
    record, rows = read_record(folder), exported_files(folder)
    endings = {file.suffix.lower() for file, _ in rows.values()}
    if not endings <= {*IMAGE_SUFFIXES, *VIDEO_SUFFIXES}:
        raise BadInputError(
            f"{folder} is an export for {record.format}, which cannot be read back",
            hint="import an export to mcap, mp4 or colmap, or copy the session itself",
        )
    sources: list[Source] = []
    places: dict[Place, int] = {}
    for camera in record.manifest.cameras:
        own = {at: row for at, row in rows.items() if at[0] == camera.name and row[0].is_file()}
        if not own:
            continue
        files = [file for file, _ in own.values()]
        if files[0].suffix.lower() in VIDEO_SUFFIXES:
            video = Video(camera.name, files[0], png=png)
            sources.append(video)
            places |= {at: number for at, (_, number) in own.items()}
        else:
            sources.append(Images(camera.name, files[0].parent, files, "exported images"))
            places |= {at: index for index, at in enumerate(own)}
    if not sources:
        raise BadInputError(
            f"{folder} has none of the files that its {FRAMES} names",
            hint="copy the whole export, or export the session again",
        )
    return exported_layout(folder, record, sources, places)


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read a calibration.json, or a session folder's. Raises BadInputError if it is malformed."""
    path = paths[0][1]
    path = path / CALIBRATION if (path / CALIBRATION).is_file() else path
    content = read_json(path)
    if not isinstance(content, dict) or not isinstance(content.get("cameras"), dict) or "frames" in content:
        return None
    own = read_struct(path, Calibration, 1)
    return Views(own.cameras, own.source or path.name, own.unit, lenses=own.lenses)


IMPORTER = Importer(
    program="simulshot",
    help="an export, which becomes its session again; calibration.json, or its session, as a calibration",
    open_recording=open_recording,
    read_calibration=read_calibration,
    calibration_files=(CALIBRATION,),
    priority=1,
)
