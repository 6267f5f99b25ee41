"""Caliscope: recordings with a table of times, workspaces of recordings, and camera arrays.

Anipose's calibrations have the same format.
"""

import tomllib
from collections.abc import Sequence
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.session.files.untrusted_files import read_text, rejecting, within
from capture_app.session.importing.importer import Importer, open_sources
from capture_app.session.importing.recording_sources import Layout, videos_in
from capture_app.session.importing.views import EXPORT_AGAIN, View, Views, numbers, rotation_of

_TABLE, _ARRAY, _RECORDINGS = "timestamps.csv", "camera_array.toml", "recordings"
_UP = 3
"""Number of parent folders searched for the workspace, including the recording's own."""


def open_recording(path: Path, *, png: bool, recording: str | None) -> Layout | None:
    """Open a recording's folder, or one of a workspace. Raises BadInputError if the workspace has none."""
    if (path / _TABLE).is_file() and videos_in(path):
        arrays = (parent / _ARRAY for parent in (path, *path.resolve().parents[: _UP - 1]))
        return Layout(
            path=path,
            sources=tuple(open_sources([str(path)], png=png)),
            timestamps=(("", path / _TABLE),),
            calibration=next((array for array in arrays if array.is_file()), None),
        )
    if not ((path / _ARRAY).is_file() and (path / _RECORDINGS).is_dir()):
        return None
    if recording is None:
        raise BadInputError(
            f"{path} is a Caliscope workspace without a recording: none with videos and their timestamps.csv",
            hint=f"name one: {path / _RECORDINGS}/NAME",
        )
    return open_recording(path / _RECORDINGS / recording, png=png, recording=None)


def recordings_in(folder: Path) -> list[str]:
    """Return the names of the recordings in a workspace; none for other folders."""
    inner = (folder / _RECORDINGS).glob("*") if (folder / _ARRAY).is_file() else ()
    return sorted(path.name for path in inner if (path / _TABLE).is_file() and videos_in(path))


MAX_BYTES, MAX_DOTS = 1 << 18, 1 << 8
"""Maximum size of a file, and dots in a line: time and memory of a key grow with the square of its parts."""


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read the cameras of a Caliscope or Anipose TOML; a rotation is a matrix or a Rodrigues vector.

    Raises BadInputError, with the camera, if the file is malformed or not calibrated yet.
    """
    path = paths[0][1]
    if path.suffix.lower() != ".toml":
        return None
    with rejecting(f"cannot read the calibration {path}", ValueError, RecursionError, hint=EXPORT_AGAIN):
        text = read_text(path, max_bytes=MAX_BYTES)
        within(max(line.count(".") for line in text.split("\n")), MAX_DOTS, "dots in a line")
        content = tomllib.loads(text)
    tables = content["cameras"] if isinstance(content.get("cameras"), dict) else content
    own = {key: table for key, table in tables.items() if isinstance(table, dict) and "matrix" in table}
    if not own:
        raise BadInputError(f"{path} has no camera with a matrix", hint="give Caliscope's camera_array.toml")
    views = {}
    for key, table in own.items():
        label = str(table.get("name", table.get("cam_id", table.get("port", key))))
        where = f"{path}: camera {label}"
        if "rotation" not in table and "translation" not in table:
            raise BadInputError(
                f"{where} has a lens, but no pose yet",
                hint="calibrate the poses of the cameras there; or import without --calibration, then: "
                "reconstruct calibrate SESSION",
            )
        width, height = numbers(where, table, "size", 2)
        views[label] = View(
            matrix=numbers(where, table, "matrix", 9).reshape(3, 3),
            distortion=numbers(where, table, "distortions", 4, 5, 8),
            rotation=rotation_of(numbers(where, table, "rotation", 3, 9)),
            translation=numbers(where, table, "translation", 3),
            size=(int(width), int(height)),
            is_fisheye=bool(table.get("fisheye")),
            turned=f"rotation_count {turns}" if (turns := table.get("rotation_count", 0)) else "",
        )
    return Views(views, path.name)


IMPORTER = Importer(
    program="Caliscope, Anipose",
    help="a recording with timestamps.csv, or a workspace; a calibration's .toml",
    open_recording=open_recording,
    recordings_in=recordings_in,
    read_calibration=read_calibration,
    calibration_files=("camera_array.toml", "*calib*.toml", "*Calib*.toml"),
)
