"""FreeMoCap, 1 and 2: synchronized videos of as many frames each, when they were taken, and a calibration.

By freemocap's docs ("Recording folder structure") and its system/default_paths.py the videos are in
`synchronized_videos` or, in version 2, `videos/synchronized`; by skellycam's parse_video_filename.py and
recording_info.py they are named RECORDING.id-CAMERA.idx-N.mp4, and each has a table in
`timestamps/camera_timestamps/RECORDING.cameraCAMERA.timestamps.csv` with a row a frame, whose
`timestamp.perf_counter_ns.ns` is one computer's clock for all cameras. Lengths are in mm.
"""

import csv
import re
import statistics
from pathlib import Path

from capture_app.errors import BadInputError
from capture_app.session.importers.frame_matching import (
    Instant,
    TimedFrame,
    Timeline,
    check_order,
    middle,
    periods_of,
)
from capture_app.session.importers.layouts.layout import Layout
from capture_app.session.importers.open_sources import open_sources
from capture_app.session.importers.sources import videos_in

_VIDEOS = ("synchronized_videos", "videos/synchronized", "SyncedVideos")
_NAME = re.compile(r".+\.id-([^.]+)\.idx-(\d+)")
_TIME, _FRAME = "timestamp.perf_counter_ns.ns", "recording_frame_number"


def freemocap(folder: Path, *, png: bool) -> Layout | None:
    """The recording in a folder. Raises BadInputError for tables of times that contradict themselves."""
    videos = next((folder / name for name in _VIDEOS if videos_in(folder / name)), None)
    if videos is None:
        return None
    named = {_camera_name(path): path for path in videos_in(videos)}
    calibrations = sorted(folder.glob("*camera_calibration.toml"))
    tables = _tables(videos, named)
    return Layout(
        program="FreeMoCap",
        path=videos,
        sources=tuple(open_sources([f"{name}={path}" for name, path in named.items()], png=png)),
        timeline=_timeline(tables) if tables else None,
        same_frames=True,
        calibration=calibrations[0] if calibrations else None,
        unit="mm" if calibrations else None,
    )


def _camera_name(video: Path) -> str:
    """The camera's id where the name is SkellyCam's, which calibrations name it by; else the video's name."""
    found = _NAME.fullmatch(video.stem)
    return found[1] if found else video.stem


def _tables(videos: Path, named: dict[str, Path]) -> dict[str, Path]:
    """The table of each camera; none unless every camera has one."""
    folder = videos / "timestamps" / "camera_timestamps"
    found = {}
    for name, video in named.items():
        recording = video.stem.partition(".id-")[0]
        table = folder / f"{recording}.camera{name}.timestamps.csv"
        if table.is_file():
            found[name] = table
    return found if len(found) == len(named) else {}


def _timeline(tables: dict[str, Path]) -> Timeline:
    """Frames of the same number are one instant, each at its own time."""
    cameras = {name: _read(path) for name, path in tables.items()}
    for name, frames in cameras.items():
        check_order(str(tables[name]), frames)
    by_number: dict[int, dict[str, TimedFrame]] = {}
    for name, frames in cameras.items():
        for frame in frames:
            by_number.setdefault(frame.index, {})[name] = frame
    periods = periods_of(cameras)
    instants = [Instant(middle(frames), frames) for _, frames in sorted(by_number.items())]
    return Timeline(instants, round(statistics.median(periods.values())), periods)


def _read(path: Path) -> list[TimedFrame]:
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        return [TimedFrame(int(row[_FRAME]), int(row[_TIME])) for row in rows]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BadInputError(f"cannot read {path}: {error}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise BadInputError(f"{path} has no whole numbers {_FRAME} and {_TIME}") from error
