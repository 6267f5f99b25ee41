"""From the words of a spec, `replay:PATH,key=value…`, to a recording that plays as a live camera."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace

from capture_app.camera_facts import PhaseControl
from capture_app.cameras.base import Camera, CameraListing, in_node_clock
from capture_app.cameras.options import refuse_unknown
from capture_app.clock import NodeClock
from capture_app.errors import BadInputError
from capture_app.session.format.manifest import MANIFEST

if TYPE_CHECKING:
    from capture_app.cameras.replay.recordings import Recording

OPTIONS = {
    "camera": "which of several cameras of the recording; default: the one named like the node",
    "fps": "rate of a video or of images, instead of their own times",
    "phase": "how its phase is moved: reset, frame-duration, or none to keep the recording's own",
}
PHASES = (PhaseControl.RESET, PhaseControl.FRAME_DURATION, PhaseControl.NONE)


def list_cameras() -> list[CameraListing]:
    """None: recordings are named by their paths."""
    return []


def open_camera(path: str, options: Mapping[str, str], *, clock: NodeClock, name: str) -> Camera:
    """Open a session, a video or a folder of images as a camera; see OPTIONS.

    Raises BadInputError for what is no recording, a camera it does not have, or an option that cannot be
    read, IncompleteError for a session that is not complete.
    """
    refuse_unknown(options, OPTIONS, "a replay")
    fps, phase = _rate(options.get("fps")), options.get("phase")
    if phase is not None and phase not in PHASES:
        raise BadInputError(f"phase={phase} of a replay", hint=f"one of {', '.join(PHASES)}")
    from capture_app.cameras.replay.camera import ReplayCamera

    recording = _open(Path(path).expanduser(), options.get("camera"), fps, name)
    if phase is not None:
        recording.facts = replace(recording.facts, phase_control=PhaseControl(phase))
    return in_node_clock(ReplayCamera(recording), clock)


def _open(path: Path, camera: str | None, fps: float | None, node: str) -> "Recording":
    # Heavy: whoever lists cameras does without.
    from capture_app.cameras.replay.recordings import SessionRecording, SourceRecording
    from capture_app.session.importers.open_sources import open_sources
    from capture_app.session.reading.reader import Session

    if (path / MANIFEST).exists():
        if fps is not None:
            raise BadInputError(f"{path} is a session and has times of its own", hint="leave fps= out")
        session = Session.open(path)
        names = [record.name for record in session.stored_manifest.cameras]
        return SessionRecording(session, session.camera(_choice(path, names, camera, node)))
    sources = {source.name: source for source in open_sources([str(path)])}
    return SourceRecording(sources[_choice(path, list(sources), camera, node)], fps)


def _choice(path: Path, names: list[str], camera: str | None, node: str) -> str:
    """The camera that is asked for, the node's namesake, or the only one."""
    if camera is None and node not in names and len(names) > 1:
        raise BadInputError(
            f"{path} has several cameras", hint=f"choose one: camera={names[0]}; it has {', '.join(names)}"
        )
    chosen = camera or (node if node in names else names[0])
    if chosen not in names:
        raise BadInputError(f"{path} has no camera {chosen}", hint=f"it has {', '.join(names)}")
    return chosen


def _rate(text: str | None) -> float | None:
    if text is None:
        return None
    try:
        rate = float(text)
    except ValueError:
        rate = math.nan
    if not 0.1 <= rate <= 10_000:
        raise BadInputError(f"fps={text} is not a frame rate", hint="for example fps=30")
    return rate
