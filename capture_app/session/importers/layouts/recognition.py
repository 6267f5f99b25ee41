"""Recognizes recording folders of Caliscope and FreeMoCap by their files."""

from dataclasses import dataclass
from pathlib import Path

from capture_app.errors import BadInputError
from capture_app.session.importers.sources import VIDEO_SUFFIXES

_TABLE, _ARRAY, _RECORDINGS = "timestamps.csv", "camera_array.toml", "recordings"
_SYNCHRONIZED = ("synchronized_videos", "SyncedVideos")
_UP = 3
"""How many folders above a recording Caliscope's workspace may be, with the recording's own."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Where a program's folder has its videos, and its times and calibration if there are any."""

    program: str
    videos: Path
    timestamps: Path | None = None
    same_frames: bool = False
    """Frames of the same number are of one instant, at the videos' own rate."""
    calibration: Path | None = None
    unit: str | None = None


def recognize_layout(folder: Path) -> Layout | None:
    """The layout of a folder, or None. Raises BadInputError for a workspace of several recordings."""
    if not folder.is_dir():
        return None
    for name in _SYNCHRONIZED:
        if (folder / name).is_dir():
            found = sorted(folder.glob("*camera_calibration.toml"))
            calibration = found[0] if found else None
            unit = "mm" if calibration else None
            return Layout("FreeMoCap", folder / name, same_frames=True, calibration=calibration, unit=unit)
    if (folder / _TABLE).is_file() and _has_videos(folder):
        arrays = (parent / _ARRAY for parent in (folder, *folder.resolve().parents[: _UP - 1]))
        array = next((path for path in arrays if path.is_file()), None)
        return Layout("Caliscope", folder, timestamps=folder / _TABLE, calibration=array)
    if (folder / _ARRAY).is_file() and (folder / _RECORDINGS).is_dir():
        inner = [path for path in sorted((folder / _RECORDINGS).iterdir()) if (path / _TABLE).is_file()]
        inner = [path for path in inner if _has_videos(path)]
        if len(inner) == 1:
            return recognize_layout(inner[0])
        what = "without a recording: none with videos and their timestamps.csv"
        if inner:
            what = f"of several recordings: {', '.join(path.name for path in inner)}"
        hint = f"name one: {folder / _RECORDINGS}/NAME"
        raise BadInputError(f"{folder} is a Caliscope workspace {what}", hint=hint)
    return None


def _has_videos(folder: Path) -> bool:
    return any(path.suffix.lower() in VIDEO_SUFFIXES for path in folder.iterdir() if path.is_file())
