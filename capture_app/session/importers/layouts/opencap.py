"""OpenCap: the folder of a session, whose trials have a video of each camera.

By opencap-api's zipsession.py a download has `Videos/CamN/InputMedia/TRIAL/TRIAL.mov`, as the phone took it,
beside it `TRIAL_sync.mp4` where OpenCap aligned it to the others by their motion, and
`Videos/CamN/cameraIntrinsicsExtrinsics.pickle`.
"""

from pathlib import Path

from capture_app.errors import BadInputError
from capture_app.names import natural_order
from capture_app.session.importers.calibrations.opencap import PARAMETERS
from capture_app.session.importers.layouts.layout import Layout
from capture_app.session.importers.open_sources import open_sources
from capture_app.session.importers.sources import videos_in

_MEDIA, _SYNCHRONIZED = "InputMedia", "_sync"


def opencap(folder: Path, *, png: bool, recording: str | None) -> Layout | None:
    """A trial of a session. Raises BadInputError where it has several and `recording` names none of them."""
    videos = folder / "Videos" if (folder / "Videos").is_dir() else folder
    cameras = sorted(videos.glob(f"Cam*/{_MEDIA}"), key=lambda path: natural_order(path.parent.name))
    if not cameras:
        return None
    trials = sorted({trial.name for camera in cameras for trial in camera.iterdir() if videos_in(trial)})
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
    remark = ""
    if chosen is raw:
        remark = f"{trial} was not aligned by OpenCap: its phones start a little apart"
    pickles = all((camera.parent / PARAMETERS).is_file() for camera in there)
    return Layout(
        program="OpenCap",
        path=videos,
        sources=tuple(open_sources(paths, png=png)),
        same_frames=chosen is aligned,
        calibration=videos if pickles else None,
        remark=remark,
    )


def _video(folder: Path, stem: str) -> Path | None:
    """The trial's video of a name; of the original also what it was named by its number on OpenCap's side."""
    found = videos_in(folder)
    named = [path for path in found if path.stem == stem]
    if not named and not stem.endswith(_SYNCHRONIZED):
        named = [path for path in found if not path.stem.endswith(_SYNCHRONIZED)]
    return named[0] if named else None
