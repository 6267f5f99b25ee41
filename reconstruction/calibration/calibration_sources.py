"""Sources of a calibration: a board, points at rest, the session, its rig, or another session."""

import tempfile
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import combinations
from pathlib import Path

from capture_app.board.boards import Checkerboard
from capture_app.board.coverage import BoardCoverage
from capture_app.board.detector import Board, BoardDetector
from capture_app.common.errors import BadInputError
from capture_app.console.terminal import talk
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import MANIFEST
from capture_app.session.importing.calibrations import fit_calibration, read_views
from reconstruction.calibration.board_calibration import (
    calibrate_from_board,
    count_coverage,
    detect_board,
    lenses_of_recordings,
    refuse_other_sizes,
    shared_corners,
)
from reconstruction.calibration.calibrated_rig import Rig, calibrated_views, refuse_faults, sound_views
from reconstruction.calibration.consistency import MAX_AXIS_ANGLE_DEG, RigCheck, SharedPoints, check_rig
from reconstruction.calibration.stored import camera_modes, find_calibration
from reconstruction.calibration.structure_from_motion import calibrate_from_images
from reconstruction.common.geometry import View, angle_deg
from reconstruction.pairs import match_features
from reconstruction.session.conditions import evenly_spaced
from reconstruction.session.dataset import Dataset

TRIED_IMAGES = 4
"""Images of each camera that are searched for the board with columns and rows exchanged."""


class CalibrationSource(StrEnum):
    """Source of a calibration: stored in the session, computed from its images, or kept from an earlier one.

    Instead of a source, a command accepts a path: another session, or a calibration file to import.
    """

    SESSION = "session"
    SFM = "sfm"
    BOARD = "board"
    CHARUCO = "charuco"
    """Another name of `BOARD`."""
    KEPT = "kept"

    @classmethod
    def named(cls, text: str) -> "CalibrationSource | Path":
        """Return the source of this name, else a path."""
        return cls(text) if text in set(cls) else Path(text)


@dataclass(frozen=True)
class Candidate:
    """A calibration, and pixels of points that pairs of cameras share, by which it is judged."""

    calibration: Calibration
    shared: SharedPoints
    board: BoardCoverage | None = None
    """The image parts that the board covered."""
    check: RigCheck | None = None
    """Check for moved cameras, for a calibration that was not computed here."""


def from_board(
    dataset: Dataset, board: Board, recordings: tuple[Path, ...], lens_recordings: tuple[Path, ...] = ()
) -> Candidate:
    """Calibrate from recordings of a board, or from the session itself; the board's corners judge the result.

    `lens_recordings`: recordings of single cameras, for their lenses.
    """
    opened = open_recordings(dataset, recordings)
    corners = detect_board(opened, board)
    if not corners:
        _refuse_turned_board(opened[0], board)
    _say_if_ambiguous(dataset, board)
    lenses = lenses_of_recordings(dataset, board, lens_recordings)
    found = calibrate_from_board(opened[0], board, corners, lenses)
    return Candidate(found, shared_corners(corners), count_coverage(dataset, board, corners))


def _say_if_ambiguous(dataset: Dataset, board: Board) -> None:
    if isinstance(board, Checkerboard) and board.is_ambiguous and len(dataset.cameras) > 1:
        talk(
            f"a checkerboard of {board.shape} squares looks the same upside down: it is taken to be held the "
            "same way up in all cameras' pictures (one with an odd and an even side can be held in any way)"
        )


def _refuse_turned_board(dataset: Dataset, board: Board) -> None:
    """Raise BadInputError if the images show the board with columns and rows exchanged."""
    detector = BoardDetector(replace(board, across=board.down, down=board.across))
    for name in dataset.cameras:
        for instant in evenly_spaced(dataset.instants(name), TRIED_IMAGES):
            if detector.detect(dataset.grey(name, instant)):
                turned = f"{board.down}x{board.across}"
                raise BadInputError(
                    f"{name} shows a board of {turned} squares, not {board.shape}", hint=f"--board {turned}"
                )


def from_still_points(dataset: Dataset, field_of_view_deg: float | None = None) -> Candidate:
    """Calibrate by structure from motion; a known field of view helps."""
    with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
        rig = Rig(dataset, Path(scratch))
        found = calibrate_from_images(rig.motion, field_of_view_deg)
        return Candidate(found, _still_points(rig, calibrated_views(dataset, found)))


def from_elsewhere(dataset: Dataset, source: CalibrationSource | Path) -> Candidate:
    """Load a calibration of the session, its rig or another session, and check it against static points."""
    if source is CalibrationSource.SESSION:
        found = dataset.calibration()
        if found is None:
            raise BadInputError(f"{dataset.name} has no calibration of its own", hint="--from sfm finds one")
    elif source is CalibrationSource.KEPT:
        stored = find_calibration(camera_modes(dataset))
        if stored is None:
            modes = (f"{name} {of.width}x{of.height}" for name, of in sorted(camera_modes(dataset).items()))
            raise BadInputError(
                f"no calibration is kept of these cameras in these modes: {', '.join(modes)}",
                hint="reconstruct calibrate keeps one; another session's can be given by its path",
            )
        found = stored.with_origin
    else:
        found = read_calibration(dataset, Path(source))
    with tempfile.TemporaryDirectory(prefix="simulshot-") as scratch:
        rig, (views, faults) = Rig(dataset, Path(scratch)), sound_views(dataset, found)
        # A calibration that is judged, and may be stored, must have no fault at all.
        refuse_faults(dataset, (), faults)
        check = check_rig(views, rig.middle_features)
        return Candidate(found, _still_points(rig, views), check=check)


def read_calibration(dataset: Dataset, path: Path) -> Calibration:
    """Read the calibration of another session's folder, or any calibration file that can be imported.

    Raises:
        BadInputError: there is no calibration, or that session's cameras had other image sizes.
    """
    if path.is_file() or not (path / MANIFEST).is_file():
        sizes = {name: dataset.size_on_disk(name) for name in dataset.cameras}
        return fit_calibration(read_views([("", path)], dataset.cameras), sizes)
    other = Dataset.open(path)
    found = other.calibration()
    if found is None:
        raise BadInputError(f"{path} has no calibration to give", hint="reconstruct calibrate it first")
    ours, theirs = camera_modes(dataset), camera_modes(other)
    for name in ours.keys() & theirs.keys():
        if ours[name] != theirs[name]:
            of = {
                where.name: f"{mode.model} {mode.width}x{mode.height}"
                for where, mode in ((dataset, ours[name]), (other, theirs[name]))
            }
            what = ", ".join(f"{mode} in {where}" for where, mode in of.items())
            raise BadInputError(
                f"{name} is not the same camera in the same mode: {what}",
                hint="calibrate in the session's own mode, from a board: --recording BOARD_SESSION",
            )
    source = f"{found.source or 'unknown'}, given by {other.name}"
    return Calibration(cameras=found.cameras, unit=found.unit, source=source)


def open_recordings(dataset: Dataset, paths: tuple[Path, ...]) -> list[Dataset]:
    """Open the sessions that show the board to a session's cameras; without paths the session itself.

    Raises:
        BadInputError: a recording is of other cameras, or of other image sizes.
    """
    recordings = [Dataset.open(path) for path in paths] or [dataset]
    for recording in recordings:
        if recording.cameras != dataset.cameras:
            raise BadInputError(
                f"{recording.name} was taken by other cameras ({', '.join(recording.cameras)})",
                hint=f"give recordings by the cameras of {dataset.name}: {', '.join(dataset.cameras)}",
            )
        refuse_other_sizes(recording, dataset, dataset.cameras)
    return recordings


def _still_points(rig: Rig, views: dict[str, View]) -> SharedPoints:
    """Return points at rest that pairs of cameras share, at the middle of the burst."""
    features = rig.middle_features
    return {
        (a, b): match_features(features[a], features[b])
        for a, b in combinations([name for name in features if name in views], 2)
        if angle_deg(views[a].axis, views[b].axis) < MAX_AXIS_ANGLE_DEG
    }
