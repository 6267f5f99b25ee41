"""`reconstruct calibrate`: find a session's calibration, judge it, and store it in the session once."""

import tempfile
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations
from pathlib import Path

import msgspec

from capture_app.board.charuco import DEFAULT_BOARD, CharucoBoard
from capture_app.board.coverage import BoardCoverage
from capture_app.errors import BadInputError
from capture_app.session.files.durable import write_atomic
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import CALIBRATION
from capture_app.text import pretty_json
from reconstruction.calibration.charuco import (
    calibrate_from_board,
    count_coverage,
    detect_board,
    shared_corners,
)
from reconstruction.calibration.features import match_features
from reconstruction.calibration.quality import (
    CalibrationQuality,
    SharedPoints,
    judge_calibration,
    refuse_bad_calibration,
)
from reconstruction.calibration.rig import Rig, calibrated_views
from reconstruction.calibration.structure_from_motion import calibrate_from_images
from reconstruction.common.geometry import View, angle_deg
from reconstruction.session.dataset import Dataset

MAX_AXIS_ANGLE_DEG = 45.0
"""Between cameras with a larger angle between their axes features match by chance only."""

Candidate = tuple[Calibration, dict[str, View], SharedPoints]
"""A calibration, its views at the size of the pictures it is judged by, and the points that they share."""


class CalibrationSource(StrEnum):
    """Where a calibration comes from."""

    SESSION = "session"
    SFM = "sfm"
    CHARUCO = "charuco"


@dataclass(frozen=True, kw_only=True)
class CalibrateOptions:
    """`recordings`: the sessions that show the board, none = the session itself."""

    source: CalibrationSource = CalibrationSource.SFM
    board: CharucoBoard = DEFAULT_BOARD
    recordings: tuple[Path, ...] = ()
    force: bool = False


class CalibrateResult(msgspec.Struct, frozen=True, kw_only=True):
    """What was found, and whether it was stored in the session."""

    session: str
    source: str
    cameras: tuple[str, ...]
    missing: tuple[str, ...]
    """Cameras of the session without a calibration."""
    unit: str
    quality: CalibrationQuality
    board: BoardCoverage | None = None
    """For a board: what it has covered, and what would make the calibration better."""
    stored: bool


def calibrate(session: Path, options: CalibrateOptions) -> CalibrateResult:
    """Find, judge and store a session's calibration; a bad one is refused and nothing is stored.

    Raises:
        SimulshotError: the session cannot be read, has a calibration already, or none good enough is found.
    """
    dataset = Dataset.open(session)
    dataset.require_cameras(2, "a rig is two cameras or more that see the same")
    target = session / CALIBRATION
    stores = options.source is not CalibrationSource.SESSION
    if stores and target.exists() and not options.force:
        raise BadInputError(f"{session} has a calibration already", hint="--replace overwrites it")
    coverage = None
    if options.source is CalibrationSource.CHARUCO:
        (found, views, shared), coverage = _from_board(dataset, options)
    else:
        found, views, shared = _from_still_points(dataset, stores)
    quality = judge_calibration(views, shared)
    refuse_bad_calibration(quality, len(dataset.cameras))
    if stores:
        _store(target, found)
    return CalibrateResult(
        session=str(session),
        source=found.source,
        cameras=tuple(views),
        missing=tuple(name for name in dataset.cameras if name not in views),
        unit=found.unit,
        quality=quality,
        board=coverage,
        stored=stores,
    )


def cover(session: Path, options: CalibrateOptions) -> BoardCoverage:
    """What the board has covered in a session, or in its recordings.

    Raises:
        SimulshotError: a session cannot be read, or is of other cameras.
    """
    dataset = Dataset.open(session)
    return count_coverage(dataset, options.board, detect_board(_recordings(dataset, options), options.board))


def _recordings(dataset: Dataset, options: CalibrateOptions) -> list[Dataset]:
    recordings = [Dataset.open(path) for path in options.recordings] or [dataset]
    for recording in recordings:
        if recording.cameras != dataset.cameras:
            raise BadInputError(
                f"{recording.name} was taken by other cameras ({', '.join(recording.cameras)})",
                hint=f"{dataset.name} has {', '.join(dataset.cameras)}",
            )
        for name in dataset.cameras:
            if recording.size(name) != dataset.size(name):
                sizes = ["x".join(map(str, of.size(name))) for of in (recording, dataset)]
                raise BadInputError(
                    f"{name} has pictures of {sizes[0]} in {recording.name}, of {sizes[1]} in {dataset.name}",
                    hint="record the board in the mode that is used later: another may show another part",
                )
    return recordings


def _from_board(dataset: Dataset, options: CalibrateOptions) -> tuple[Candidate, BoardCoverage]:
    """The calibration by recordings of a board, judged by the board's corners."""
    recordings = _recordings(dataset, options)
    corners = detect_board(recordings, options.board)
    coverage = count_coverage(dataset, options.board, corners)
    found = calibrate_from_board(recordings[0], options.board, corners)
    return (found, calibrated_views(dataset, found), shared_corners(corners)), coverage


def _from_still_points(dataset: Dataset, solve: bool) -> Candidate:
    """The calibration by structure from motion, or the session's own, judged by points at rest."""
    with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
        rig = Rig(dataset, Path(scratch))
        found = None if solve else dataset.calibration()
        if solve:
            instants = range(len(dataset.instants_ns))
            found = calibrate_from_images(dataset, rig.motion.widened_movers, instants)
        if found is None:
            raise BadInputError(f"{dataset.name} has no calibration of its own", hint="--from sfm finds one")
        views = calibrated_views(dataset, found)
        return found, views, _still_points(rig, views)


def _still_points(rig: Rig, views: dict[str, View]) -> SharedPoints:
    """Points at rest that pairs of cameras share, at the middle of the burst."""
    features = rig.features(len(rig.dataset.instants_ns) // 2)
    return {
        (a, b): match_features(features[a], features[b])
        for a, b in combinations([name for name in features if name in views], 2)
        if angle_deg(views[a].axis, views[b].axis) < MAX_AXIS_ANGLE_DEG
    }


def _store(target: Path, calibration: Calibration) -> None:
    try:
        write_atomic(target, pretty_json(calibration))
    except OSError as error:
        raise BadInputError(f"cannot write {target}: {error.strerror or error}") from error
