"""Caliscope: videos with `timestamps.csv` beside them, in a workspace with its `camera_array.toml`."""

from pathlib import Path

from capture_app.errors import BadInputError
from capture_app.session.importers.layouts.layout import Layout
from capture_app.session.importers.open_sources import open_sources
from capture_app.session.importers.sources import videos_in

_TABLE, _ARRAY, _RECORDINGS = "timestamps.csv", "camera_array.toml", "recordings"
_UP = 3
"""How many folders above a recording the workspace may be, with the recording's own."""


def caliscope(folder: Path, *, png: bool, recording: str | None) -> Layout | None:
    """A recording's folder or a workspace. Raises BadInputError for a workspace of several recordings."""
    if (folder / _TABLE).is_file() and videos_in(folder):
        arrays = (parent / _ARRAY for parent in (folder, *folder.resolve().parents[: _UP - 1]))
        return Layout(
            program="Caliscope",
            path=folder,
            sources=tuple(open_sources([str(folder)], png=png)),
            timestamps=folder / _TABLE,
            calibration=next((path for path in arrays if path.is_file()), None),
        )
    if not ((folder / _ARRAY).is_file() and (folder / _RECORDINGS).is_dir()):
        return None
    inner = [path for path in sorted((folder / _RECORDINGS).iterdir()) if (path / _TABLE).is_file()]
    inner = [path for path in inner if videos_in(path) and recording in (None, path.name)]
    if len(inner) == 1:
        return caliscope(inner[0], png=png, recording=None)
    what = "without a recording: none with videos and their timestamps.csv"
    if inner:
        what = f"of several recordings: {', '.join(path.name for path in inner)}"
    hint = f"name one: {folder / _RECORDINGS}/NAME"
    raise BadInputError(f"{folder} is a Caliscope workspace {what}", hint=hint)
