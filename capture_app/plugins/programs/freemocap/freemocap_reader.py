"""FreeMoCap, 1 and 2: a recording of videos with equal numbers of frames.

According to its docs ("Recording folder structure") and its system/default_paths.py, the videos are in
`synchronized_videos` or, in version 2, `videos/synchronized`. According to skellycam's
parse_video_filename.py and recording_info.py they are named RECORDING.id-CAMERA.idx-N.mp4. Each has a table
in `timestamps/camera_timestamps/RECORDING.cameraCAMERA.timestamps.csv` with a row for each frame; its
`timestamp.perf_counter_ns.ns` is one computer's clock for all cameras. Lengths are in mm; the calibration is
Anipose's.
"""

import csv
import re
import statistics
from pathlib import Path

from capture_app.session.files.untrusted_files import read_text, rejecting
from capture_app.session.importing.frame_matching import (
    Instant,
    TimedFrame,
    Timeline,
    check_order,
    middle,
    periods_of,
)
from capture_app.session.importing.importer import Importer, open_sources
from capture_app.session.importing.recording_sources import Layout, videos_in

_VIDEOS = ("synchronized_videos", "videos/synchronized", "SyncedVideos")
_NAME = re.compile(r".+\.id-([^.]+)\.idx-(\d+)")
_TIME, _FRAME = "timestamp.perf_counter_ns.ns", "recording_frame_number"


def open_recording(path: Path, *, png: bool, recording: str | None) -> Layout | None:
    """Open the recording in a folder. Raises BadInputError if its tables of times contradict themselves."""
    videos = next((path / name for name in _VIDEOS if videos_in(path / name)), None)
    if videos is None:
        return None
    # Calibrations name a camera by the id in SkellyCam's names.
    matches = {video: _NAME.fullmatch(video.stem) for video in videos_in(videos)}
    named = {name[1] if name else video.stem: video for video, name in matches.items()}
    calibration = min(path.glob("*camera_calibration.toml"), default=None)
    tables = _tables(videos, named)
    return Layout(
        path=videos,
        sources=tuple(open_sources([f"{name}={video}" for name, video in named.items()], png=png)),
        timeline=_timeline(tables) if tables else None,
        same_frames=True,
        calibration=calibration,
        unit="mm" if calibration else None,
    )


def _tables(videos: Path, named: dict[str, Path]) -> dict[str, Path]:
    """Return the table of each camera; none unless every camera has one."""
    tables = {
        name: videos
        / f"timestamps/camera_timestamps/{video.stem.partition('.id-')[0]}.camera{name}.timestamps.csv"
        for name, video in named.items()
    }
    return tables if all(table.is_file() for table in tables.values()) else {}


def _timeline(tables: dict[str, Path]) -> Timeline:
    """Group the cameras' frames of equal number into one instant each; every frame keeps its own time."""
    cameras = {name: _read(path) for name, path in tables.items()}
    by_number: dict[int, dict[str, TimedFrame]] = {}
    for name, frames in cameras.items():
        check_order(str(tables[name]), frames)
        for frame in frames:
            by_number.setdefault(frame.index, {})[name] = frame
    periods = periods_of(cameras)
    instants = [Instant(middle(frames), frames) for _, frames in sorted(by_number.items())]
    return Timeline(instants, round(statistics.median(periods.values())), periods)


def _read(path: Path) -> list[TimedFrame]:
    with rejecting(
        f"{path} has no whole numbers {_FRAME} and {_TIME}",
        *(KeyError, TypeError, ValueError, csv.Error),
        hint="process the recording again with FreeMoCap, or import with --fps RATE",
    ):
        return [
            TimedFrame(int(row[_FRAME]), int(row[_TIME]))
            for row in csv.DictReader(read_text(path).splitlines())
        ]


IMPORTER = Importer(
    program="FreeMoCap",
    help="a recording's synchronized videos, their tables of times, *_camera_calibration.toml",
    open_recording=open_recording,
)
