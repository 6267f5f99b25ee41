"""`reconstruct calibrate`: find and judge a session's calibration, and store it for session and rig."""

from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from capture_app.board.boards import DEFAULT_BOARD
from capture_app.board.coverage import BoardCoverage
from capture_app.board.detector import Board
from capture_app.common.errors import BadInputError
from capture_app.common.text import count
from capture_app.console.terminal import talk
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import CALIBRATION
from reconstruction.calibration.board_calibration import count_coverage, detect_board
from reconstruction.calibration.calibrated_rig import calibrated_views
from reconstruction.calibration.calibration_sources import (
    CalibrationSource,
    Candidate,
    from_board,
    from_elsewhere,
    from_still_points,
    open_recordings,
)
from reconstruction.calibration.consistency import (
    CalibrationQuality,
    RigCheck,
    judge_calibration,
    refuse_bad_calibration,
)
from reconstruction.calibration.stored import keep_calibration, write_calibration
from reconstruction.calibration.structure_from_motion import GIVE_LENSES, GUESS
from reconstruction.calibration.world import (
    Marks,
    World,
    in_world,
    marked_points,
    metres_per_unit_by_board,
    world_of_board,
    world_of_marks,
)
from reconstruction.session.dataset import Dataset

FOUND_HERE = (CalibrationSource.SFM, CalibrationSource.BOARD, CalibrationSource.CHARUCO)


@dataclass(frozen=True, kw_only=True)
class CalibrateOptions:
    """Options of `reconstruct calibrate`; `recordings`: sessions that show the board, none = this session."""

    source: CalibrationSource | Path = CalibrationSource.SFM
    """Source of the calibration; a path is another session or a calibration file to import."""
    board: Board = DEFAULT_BOARD
    recordings: tuple[Path, ...] = ()
    lens_recordings: tuple[Path, ...] = ()
    """Sessions in which single cameras see the board, for their lenses."""
    field_of_view_deg: float | None = None
    """Horizontal field of view, for structure from motion; None = from EXIF, else unknown."""
    distance: tuple[Marks, float] | None = None
    """Two marked points and their distance in metres, which sets the scale."""
    scale_by_board: bool = False
    """Set the scale from a board that is in the scene."""
    ground: Path | None = None
    """A session with the board on the ground."""
    vertical: Marks | None = None
    """Two points one above the other, the first on the ground."""
    keep: bool | None = None
    """Store the calibration for the rig's later sessions; None = only if it was computed here."""
    force: bool = False

    @property
    def rescales(self) -> bool:
        """Whether the options change the calibration's scale, or its origin and vertical."""
        return (
            self.distance is not None
            or self.scale_by_board
            or self.ground is not None
            or self.vertical is not None
        )


class CalibrateResult(msgspec.Struct, frozen=True, kw_only=True):
    """Result of `reconstruct calibrate`: the calibration, its quality, and where it was stored."""

    session: str
    source: str
    cameras: tuple[str, ...]
    missing: tuple[str, ...]
    """Cameras of the session without a calibration."""
    unit: str
    quality: CalibrationQuality
    check: RigCheck | None = None
    """Check for moved cameras; only for a calibration that was not computed here."""
    board: BoardCoverage | None = None
    """For a board: the image parts that it covered, and what would improve the calibration."""
    stored: bool
    kept: bool = False
    """Whether it was stored for the rig's later sessions."""


def calibrate(session: Path, options: CalibrateOptions) -> CalibrateResult:
    """Find, judge and store a session's calibration; a bad one is refused and nothing is stored.

    Raises:
        SimulshotError: the session cannot be read, has a calibration already, or none good enough is found.
    """
    dataset = Dataset.open(session)
    dataset.require_cameras(2, "a rig is two cameras or more that see the same")
    target = session / CALIBRATION
    own = options.source is CalibrationSource.SESSION
    stores = not own or options.rescales
    if stores and target.exists() and not options.force:
        raise BadInputError(f"{session} has a calibration already", hint="--replace overwrites it")
    candidate = _candidate(dataset, options)
    found = candidate.calibration
    views = calibrated_views(dataset, found)
    quality = judge_calibration(views, candidate.shared)
    if options.source in FOUND_HERE or own:
        advice = f", {GIVE_LENSES}" if GUESS in found.source else ""
        refuse_bad_calibration(quality, len(dataset.cameras), advice)
    if candidate.check is not None and not candidate.check.holds:
        raise BadInputError(
            f"this calibration no longer holds: {candidate.check}",
            hint="calibrate the rig again, from a board",
        )
    if options.rescales:
        found = _rescaled(dataset, found, options)
    if stores:
        write_calibration(target, found)
    keeps = options.source in FOUND_HERE or options.rescales if options.keep is None else options.keep
    return CalibrateResult(
        session=str(session),
        source=found.source,
        cameras=tuple(views),
        missing=tuple(name for name in dataset.cameras if name not in views),
        unit=found.unit,
        quality=quality,
        check=candidate.check,
        board=candidate.board,
        stored=stores,
        kept=keeps and _keep(dataset, found),
    )


def cover(session: Path, options: CalibrateOptions) -> BoardCoverage:
    """Return the image parts that the board covered in a session, or in its recordings.

    Raises:
        SimulshotError: a session cannot be read, or is of other cameras.
    """
    dataset = Dataset.open(session)
    corners = detect_board(open_recordings(dataset, options.recordings), options.board)
    return count_coverage(dataset, options.board, corners)


def _candidate(dataset: Dataset, options: CalibrateOptions) -> Candidate:
    match options.source:
        case CalibrationSource.BOARD | CalibrationSource.CHARUCO:
            return from_board(dataset, options.board, options.recordings, options.lens_recordings)
        case CalibrationSource.SFM:
            return from_still_points(dataset, options.field_of_view_deg)
        case _:
            return from_elsewhere(dataset, options.source)


def _rescaled(dataset: Dataset, found: Calibration, options: CalibrateOptions) -> Calibration:
    views = calibrated_views(dataset, found)
    if options.distance is not None:
        marks, metres = options.distance
        first, second = marked_points(views, marks)
        world = World(np.eye(3), np.zeros(3), metres / float(np.linalg.norm(first - second)))
        found = in_world(found, world, "m", f"scale from a distance of {metres:g} m")
    elif options.scale_by_board:
        corners = detect_board(open_recordings(dataset, options.recordings), options.board)
        factor, times = metres_per_unit_by_board(views, options.board, corners)
        world = World(np.eye(3), np.zeros(3), factor)
        found = in_world(found, world, "m", f"scale from a board seen by {times} pairs")
    views = calibrated_views(dataset, found)
    if options.vertical is not None:
        world = world_of_marks(views, options.vertical)
        return in_world(found, world, found.unit, "z up, ground by two points one above the other")
    if options.ground is not None:
        floor = open_recordings(dataset, (options.ground,))
        corners = detect_board(floor, options.board)
        world, times = world_of_board(views, options.board, corners, metric=found.unit == "m")
        seen = count(times, "instant")
        return in_world(found, world, "m", f"z up, ground by a board on it in {floor[0].name}, at {seen}")
    return found


def _keep(dataset: Dataset, calibration: Calibration) -> bool:
    """Store the calibration for later sessions of the rig; return False, after a message, if that fails."""
    try:
        keep_calibration(dataset, calibration)
    except BadInputError as error:
        talk(f"the calibration is not kept for later sessions: {error}")
        return False
    return True
