"""Folders of other programs, and our own exports, recognized by their files.

FreeMoCap, 1 and 2, by its docs ("Recording folder structure") and its system/default_paths.py: videos of as
many frames each in `synchronized_videos` or, in version 2, `videos/synchronized`; by skellycam's
parse_video_filename.py and recording_info.py they are named RECORDING.id-CAMERA.idx-N.mp4, and each has a
table in `timestamps/camera_timestamps/RECORDING.cameraCAMERA.timestamps.csv` with a row a frame, whose
`timestamp.perf_counter_ns.ns` is one computer's clock for all cameras. Lengths are in mm. OpenCap, by
opencap-api's zipsession.py: a download has `Videos/CamN/InputMedia/TRIAL/TRIAL.mov`, as the phone took it,
beside it `TRIAL_sync.mp4` where OpenCap aligned it to the others by their motion, and
`Videos/CamN/cameraIntrinsicsExtrinsics.pickle`.
"""

import csv
import re
import statistics
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.common.names import natural_order
from capture_app.session.exchange import RECORD
from capture_app.session.files.strangers import read_text
from capture_app.session.importers.bags import is_bag
from capture_app.session.importers.calibrations.motion_capture import EXTRINSICS, INTRINSICS, PARAMETERS
from capture_app.session.importers.frame_matching import (
    Instant,
    TimedFrame,
    Timeline,
    check_order,
    middle,
    periods_of,
)
from capture_app.session.importers.open_sources import open_sources
from capture_app.session.importers.own_exports import exported, of_messages
from capture_app.session.importers.sources import Layout, videos_in

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
    inner = [folder / _RECORDINGS / name for name in recordings_in(folder) if recording in (None, name)]
    if len(inner) == 1:
        return caliscope(inner[0], png=png, recording=None)
    what = "without a recording: none with videos and their timestamps.csv"
    if inner:
        what = f"of several recordings: {', '.join(path.name for path in inner)}"
    raise BadInputError(
        f"{folder} is a Caliscope workspace {what}", hint=f"name one: {folder / _RECORDINGS}/NAME"
    )


_VIDEOS = ("synchronized_videos", "videos/synchronized", "SyncedVideos")
_NAME = re.compile(r".+\.id-([^.]+)\.idx-(\d+)")
_TIME, _FRAME = "timestamp.perf_counter_ns.ns", "recording_frame_number"


def freemocap(folder: Path, *, png: bool) -> Layout | None:
    """The recording in a folder. Raises BadInputError for tables of times that contradict themselves."""
    videos = next((folder / name for name in _VIDEOS if videos_in(folder / name)), None)
    if videos is None:
        return None
    # Calibrations name a camera by the id in SkellyCam's names.
    found = {path: _NAME.fullmatch(path.stem) for path in videos_in(videos)}
    named = {name[1] if name else path.stem: path for path, name in found.items()}
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


def _tables(videos: Path, named: dict[str, Path]) -> dict[str, Path]:
    """The table of each camera; none unless every camera has one."""
    folder = videos / "timestamps" / "camera_timestamps"
    tables = {
        name: folder / f"{video.stem.partition('.id-')[0]}.camera{name}.timestamps.csv"
        for name, video in named.items()
    }
    return tables if all(table.is_file() for table in tables.values()) else {}


def _timeline(tables: dict[str, Path]) -> Timeline:
    """Frames of the same number are one instant, each at its own time."""
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
    try:
        rows = csv.DictReader(read_text(path).splitlines())
        return [TimedFrame(int(row[_FRAME]), int(row[_TIME])) for row in rows]
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise BadInputError(f"{path} has no whole numbers {_FRAME} and {_TIME}") from error


_MEDIA, _SYNCHRONIZED = "InputMedia", "_sync"


def opencap(folder: Path, *, png: bool, recording: str | None) -> Layout | None:
    """A trial of a session. Raises BadInputError where it has several and `recording` names none of them."""
    cameras = _opencap_cameras(folder)
    if not cameras:
        return None
    videos, trials = cameras[0].parents[1], recordings_in(folder)
    if recording is not None and recording not in trials:
        raise BadInputError(f"{folder} has no trial {recording}", hint=f"it has {', '.join(trials)}")
    if recording is None and len(trials) != 1:
        raise BadInputError(
            f"{folder} has {'several trials: ' + ', '.join(trials) if trials else 'no trial with a video'}",
            hint="choose one: --recording NAME",
        )
    trial = recording or trials[0]
    there = [camera for camera in cameras if videos_in(camera / trial)]
    raw, aligned = (
        [_video(camera / trial, name) for camera in there] for name in (trial, trial + _SYNCHRONIZED)
    )
    chosen = aligned if None not in aligned else raw
    paths = [f"{camera.parent.name}={path}" for camera, path in zip(there, chosen, strict=True)]
    if None in chosen:
        raise BadInputError(f"{folder}: not every camera has a video {trial}", hint="name them: NAME=PATH")
    apart = f"{trial} was not aligned by OpenCap: its phones start a little apart"
    pickles = all((camera.parent / PARAMETERS).is_file() for camera in there)
    return Layout(
        program="OpenCap",
        path=videos,
        sources=tuple(open_sources(paths, png=png)),
        same_frames=chosen is aligned,
        calibration=videos if pickles else None,
        remark=apart if chosen is raw else "",
    )


def _video(folder: Path, stem: str) -> Path | None:
    """The trial's video of a name; of the original also what it was named by its number on OpenCap's side."""
    found = videos_in(folder)
    named = [path for path in found if path.stem == stem]
    if not named and not stem.endswith(_SYNCHRONIZED):
        named = [path for path in found if not path.stem.endswith(_SYNCHRONIZED)]
    return named[0] if named else None


def easymocap(folder: Path, *, png: bool) -> Layout | None:
    """A sequence with its calibration; to EasyMocap, frames of equal number are one instant."""
    if not all((folder / name).is_file() for name in (INTRINSICS, EXTRINSICS)):
        return None
    place = next((folder / name for name in ("videos", "images") if (folder / name).is_dir()), folder)
    sources = tuple(open_sources([str(place)], png=png))
    return Layout(program="EasyMocap", path=place, sources=sources, same_frames=True, calibration=folder)


def recordings_in(folder: Path) -> list[str]:
    """The names of the recordings in a folder of OpenCap or a workspace of Caliscope; else none."""
    trials = {
        trial.name for camera in _opencap_cameras(folder) for trial in camera.iterdir() if videos_in(trial)
    }
    inner = (folder / _RECORDINGS).glob("*") if (folder / _ARRAY).is_file() else ()
    return sorted(trials | {path.name for path in inner if (path / _TABLE).is_file() and videos_in(path)})


def _opencap_cameras(folder: Path) -> list[Path]:
    videos = folder / "Videos" if (folder / "Videos").is_dir() else folder
    return sorted(videos.glob(f"Cam*/{_MEDIA}"), key=lambda path: natural_order(path.parent.name))


def recognize_layout(path: Path, *, png: bool = False, recording: str | None = None) -> Layout | None:
    """The layout of a folder or an .mcap file, or None.

    `recording` names one of several in it; `png` as of `Video`. Raises BadInputError where it has several.
    """
    if is_bag(path) and path.exists():
        return of_messages(path)
    if not path.is_dir():
        return None
    if (path / RECORD).is_file():
        return exported(path, png=png)
    return (
        freemocap(path, png=png)
        or caliscope(path, png=png, recording=recording)
        or opencap(path, png=png, recording=recording)
        or easymocap(path, png=png)
    )
