"""`reconstruct calibrate`: find a session's calibration, judge it, and store it in the session once."""

import tempfile
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations
from pathlib import Path

import msgspec

from capture_app.errors import BadInputError
from capture_app.session.files.durable import write_whole
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import CALIBRATION
from reconstruction.calibration import charuco, charuco_board
from reconstruction.calibration.features import find_points, match_points
from reconstruction.calibration.quality import Quality, Shared, judge, refuse_bad
from reconstruction.calibration.rig import Rig
from reconstruction.calibration.session_calibration import find_calibration, views_of
from reconstruction.common.geometry import View, angle_deg
from reconstruction.common.stages import Stages
from reconstruction.session.dataset import Dataset
from reconstruction.session.scene_motion import SceneMotion

MOST_APART_DEG = 45.0
"""Cameras that look further apart find the same points by chance only."""


class Source(StrEnum):
    """Where a calibration comes from."""

    SESSION = "session"
    SFM = "sfm"
    CHARUCO = "charuco"


@dataclass(frozen=True, kw_only=True)
class CalibrateOptions:
    """`recording`: the session that shows the board, None = the session itself."""

    source: Source = Source.SFM
    board: charuco_board.Board | None = None
    recording: Path | None = None
    force: bool = False


class CalibrateResult(msgspec.Struct, frozen=True, kw_only=True):
    """What was found, and whether it was stored in the session."""

    session: str
    source: str
    cameras: tuple[str, ...]
    missing: tuple[str, ...]
    """Cameras of the session without a calibration."""
    unit: str
    quality: Quality
    stored: bool


def calibrate(session: Path, options: CalibrateOptions) -> CalibrateResult:
    """Find, judge and store a session's calibration; a bad one is refused and nothing is stored.

    Raises:
        SimulshotError: the session cannot be read, has a calibration already, or none good enough is found.
    """
    dataset = Dataset.open(session)
    if len(dataset.cameras) < 2:
        raise BadInputError(
            f"the session has one camera only ({', '.join(dataset.cameras)})",
            hint="a rig is two cameras or more that see the same",
        )
    target = session / CALIBRATION
    own = dataset.calibration()
    stores = options.source is not Source.SESSION
    if stores and target.exists() and not options.force:
        raise BadInputError(f"{session} has a calibration already", hint="--force replaces it")
    shared: Shared
    if options.source is Source.CHARUCO:
        if options.board is None:
            raise BadInputError("a board must be described", hint="--board 7x5 --square-mm 40 --marker-mm 30")
        recording = Dataset.open(options.recording) if options.recording is not None else dataset
        if recording.cameras != dataset.cameras:
            raise BadInputError(
                f"{options.recording} was taken by other cameras ({', '.join(recording.cameras)})",
                hint=f"{session} has {', '.join(dataset.cameras)}",
            )
        corners = charuco_board.find_corners(recording, options.board)
        found = charuco.calibrate(recording, options.board, corners)
        shared = charuco_board.shared_corners(corners)
        views = views_of(recording, found)
    else:
        with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
            rig = Rig(dataset, SceneMotion(dataset, 1), Stages(Path(scratch), dataset.fingerprint()))
            if options.source is Source.SFM:
                found = find_calibration(dataset, rig.movers, range(len(dataset.instants_ns)))
            elif own is None:
                raise BadInputError(f"{session} has no calibration of its own", hint="--from sfm finds one")
            else:
                found = own
            views = views_of(dataset, found)
            shared = _still_points(rig, views)
    quality = judge(views, shared)
    refuse_bad(quality, len(dataset.cameras))
    if stores:
        _store(target, found)
    return CalibrateResult(
        session=str(session),
        source=found.source,
        cameras=tuple(views),
        missing=tuple(name for name in dataset.cameras if name not in views),
        unit=found.unit,
        quality=quality,
        stored=stores,
    )


def _still_points(rig: Rig, views: dict[str, View]) -> Shared:
    """Points at rest that pairs of cameras share, at the middle of the burst."""
    dataset = rig.dataset
    middle = len(dataset.instants_ns) // 2
    points = {}
    for name in dataset.cameras:
        there = dataset.instants(name)
        if there:
            nearest = min(there, key=lambda k: abs(k - middle))
            points[name] = find_points(dataset.grey(name, nearest), rig.movers(name, nearest))
    return {
        (a, b): match_points(points[a], points[b])
        for a, b in combinations([name for name in points if name in views], 2)
        if angle_deg(views[a].axis, views[b].axis) < MOST_APART_DEG
    }


def _store(target: Path, calibration: Calibration) -> None:
    try:
        write_whole(target, msgspec.json.format(msgspec.json.encode(calibration), indent=2))
    except OSError as error:
        raise BadInputError(f"cannot write {target}: {error.strerror or error}") from error
