"""OpenCap: a session of trials, and the calibrations of its phones.

According to opencap-api's zipsession.py, a download has the phone's original video as
`Videos/CamN/InputMedia/TRIAL/TRIAL.mov`. Beside it is `TRIAL_sync.mp4` if OpenCap aligned it to the others by
their motion. The calibration is `Videos/CamN/cameraIntrinsicsExtrinsics.pickle`; according to opencap-core's
utilsChecker.py, imageSize is (height, width), and the board's squares are in mm.
"""

from collections.abc import Sequence
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.common.names import natural_order
from capture_app.session.files.pickled_arrays import read_pickle
from capture_app.session.importing.importer import Importer, open_sources
from capture_app.session.importing.recording_sources import Layout, videos_in
from capture_app.session.importing.views import View, Views, numbers

_MEDIA, _SYNCHRONIZED = "InputMedia", "_sync"
_PARAMETERS = "cameraIntrinsicsExtrinsics.pickle"


def open_recording(path: Path, *, png: bool, recording: str | None) -> Layout | None:
    """Open a trial of a session. Raises BadInputError if it has none with a video."""
    if not (cameras := _cameras(path)):
        return None
    if (trial := recording) is None:
        raise BadInputError(
            f"{path} has no trial with a video", hint="download its videos, or name them: NAME=PATH"
        )
    videos = cameras[0].parents[1]
    there = [camera for camera in cameras if videos_in(camera / trial)]
    raw, aligned = (
        [_video(camera / trial, name) for camera in there] for name in (trial, trial + _SYNCHRONIZED)
    )
    chosen = aligned if None not in aligned else raw
    if None in chosen:
        raise BadInputError(f"{path}: not every camera has a video {trial}", hint="name them: NAME=PATH")
    paths = [f"{camera.parent.name}={video}" for camera, video in zip(there, chosen, strict=True)]
    return Layout(
        path=videos,
        sources=tuple(open_sources(paths, png=png)),
        same_frames=chosen is aligned,
        calibration=videos if all((camera.parent / _PARAMETERS).is_file() for camera in there) else None,
        notes=[f"{trial} was not aligned by OpenCap: its phones start a little apart"] * (chosen is raw),
    )


def _video(folder: Path, stem: str) -> Path | None:
    """Return the trial's video with this stem; an original may also be named by OpenCap's trial id."""
    videos = videos_in(folder)
    named = [path for path in videos if path.stem == stem]
    if not stem.endswith(_SYNCHRONIZED):
        named += [path for path in videos if not path.stem.endswith(_SYNCHRONIZED)]
    return named[0] if named else None


def recordings_in(folder: Path) -> list[str]:
    """Return the names of the trials in a session; none for other folders."""
    return sorted(
        {trial.name for camera in _cameras(folder) for trial in camera.iterdir() if videos_in(trial)}
    )


def _cameras(folder: Path) -> list[Path]:
    videos = folder / "Videos" if (folder / "Videos").is_dir() else folder
    return sorted(videos.glob(f"Cam*/{_MEDIA}"), key=lambda path: natural_order(path.parent.name))


def read_calibration(paths: Sequence[tuple[str, Path]], cameras: Sequence[str]) -> Views | None:
    """Read pickles, each with its camera's name (or '' for its folder's name), or a folder of cameras.

    Raises BadInputError, with the file, if it is malformed or not calibrated yet.
    """
    first = paths[0][1]
    is_own = (
        any(first.glob(f"*/{_PARAMETERS}"))
        if first.is_dir()
        else first.suffix in (".pickle", ".pkl") and "stereo" not in first.name
    )
    if not is_own:
        return None
    files = {
        name or file.resolve().parent.name: file
        for name, path in paths
        for file in (sorted(path.glob(f"*/{_PARAMETERS}")) if path.is_dir() else [path])
    }
    return Views({name: _view(file) for name, file in files.items()}, _PARAMETERS, "mm")


def _view(file: Path) -> View:
    content = read_pickle(file, hint="download the session from OpenCap again")
    where = str(file)
    size = numbers(where, content, "imageSize", 2)
    return View(
        matrix=numbers(where, content, "intrinsicMat", 9).reshape(3, 3),
        distortion=numbers(where, content, "distortion", 4, 5),
        rotation=numbers(where, content, "rotation", 9).reshape(3, 3),
        translation=numbers(where, content, "translation", 3),
        size=(round(size[1]), round(size[0])),
    )


IMPORTER = Importer(
    program="OpenCap",
    help="a session of trials; its cameraIntrinsicsExtrinsics.pickle as a calibration",
    open_recording=open_recording,
    recordings_in=recordings_in,
    read_calibration=read_calibration,
    calibration_per_camera=True,
    priority=-1,
)
