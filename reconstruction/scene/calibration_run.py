"""`reconstruct calibrate`: find and judge a session's calibration, and store it for session and rig."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import combinations
from pathlib import Path

import msgspec
import numpy as np

from capture_app.board.boards import DEFAULT_BOARD, PLAIN, Checkerboard, squares_seen
from capture_app.board.coverage import BoardCoverage
from capture_app.board.detector import Board, BoardDetector
from capture_app.common.errors import BadInputError
from capture_app.common.text import count
from capture_app.console.terminal import talk
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.manifest import CALIBRATION, MANIFEST
from capture_app.session.importing.calibrations import fit_calibration, read_views
from reconstruction.common.geometry import View, angle_deg
from reconstruction.scene.calibration.board_bundle import CameraErrors
from reconstruction.scene.calibration.board_calibration import (
    LensModel,
    calibrate_from_board,
    count_coverage,
    detect_board,
    lenses_of_recordings,
    refuse_other_sizes,
    shared_corners,
)
from reconstruction.scene.calibration.consistency import (
    MAX_AXIS_ANGLE_DEG,
    CalibrationCheck,
    CalibrationQuality,
    SharedPoints,
    check_rig,
    judge_calibration,
    refuse_bad_calibration,
)
from reconstruction.scene.calibration.soundness import calibrated_views, refuse_faults, sound_views
from reconstruction.scene.calibration.stored import (
    camera_modes,
    find_calibration,
    keep_calibration,
    write_calibration,
)
from reconstruction.scene.calibration.structure_from_motion import GIVE_LENSES, calibrate_from_images
from reconstruction.scene.calibration.world import (
    Marks,
    World,
    in_world,
    marked_points,
    metres_per_unit_by_board,
    world_of_board,
    world_of_marks,
)
from reconstruction.scene.conditions import evenly_spaced
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.pairs import Features, match_features
from reconstruction.scene.scene import Scene


class CalibrationSource(StrEnum):
    """Source of a calibration: stored in the session, computed from its images, or kept from an earlier one.

    Instead of a source, a command accepts a path: another session, or a calibration file to import.
    """

    SESSION = "session"
    SFM = "sfm"
    BOARD = "board"
    CHARUCO = "charuco"
    """Another name of `BOARD`."""
    STORED = "kept"

    @classmethod
    def named(cls, text: str) -> "CalibrationSource | Path":
        """Return the source of this name, else a path."""
        return cls(text) if text in set(cls) else Path(text)


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
    lens: LensModel = LensModel.AUTO
    """Model of the lenses; structure from motion takes perspective ones for `auto`."""
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
    check: CalibrationCheck | None = None
    """Check against points at rest; only for a calibration that was not computed here."""
    board: BoardCoverage | None = None
    """For a board: the image parts that it covered, and what would improve the calibration."""
    errors: dict[str, CameraErrors] = {}
    """For a board: the 95 % errors of each camera."""
    labels: dict[str, str] = {}
    """As in `Provenance`."""
    stored: bool
    kept: bool = False
    """Whether it was stored for the rig's later sessions."""


def calibrate(session: Path, options: CalibrateOptions) -> CalibrateResult:
    """Find, judge and store a session's calibration; a bad one is refused and nothing is stored.

    Raises:
        SimulshotError: the session cannot be read, has a calibration already, or none good enough is found.
    """
    scene = Scene.open_raw(session)
    dataset = scene.dataset
    dataset.require_cameras(2, "a rig is two cameras or more that see the same")
    target = session / CALIBRATION
    own = options.source is CalibrationSource.SESSION
    stores = not own or options.rescales
    if stores and target.exists() and not options.force:
        raise BadInputError(f"{session} has a calibration already", hint="--replace overwrites it")
    found = _candidate(scene, options)
    calibration, board = found.calibration, found.board
    views, faults = sound_views(dataset, calibration)
    refuse_faults(dataset, views, faults)
    for name, text in faults:
        talk(f"{dataset.labels[name]} is left out: {text}")
    sound = {n: camera for n, camera in calibration.cameras.items() if n in views or n not in dataset.cameras}
    calibration = msgspec.structs.replace(calibration, cameras=sound)
    quality = judge_calibration(views, found.shared)
    if options.source in FOUND_HERE or own:
        refuse_bad_calibration(
            quality, len(dataset.cameras), f", {GIVE_LENSES}" if calibration.known_lenses.is_guess else ""
        )
    check = (
        None
        if options.source is CalibrationSource.SFM
        else check_rig(views, scene.features.middle, calibration.known_lenses)
    )
    # Besides a board, there may be no more than its squares at rest, which are taken for each other.
    if check is not None and not check.holds and (board is None or check.by_lenses):
        raise BadInputError(
            f"this calibration does not hold for these pictures: {check}",
            hint="calibrate the rig from a board that is tilted and reaches the pictures' corners",
        )
    if options.rescales:
        calibration = _rescaled(dataset, calibration, options)
    if stores:
        write_calibration(target, calibration)
    keeps = options.source in FOUND_HERE or options.rescales if options.keep is None else options.keep
    return CalibrateResult(
        session=str(session),
        labels=dataset.other_labels,
        source=calibration.source,
        cameras=tuple(views),
        missing=tuple(name for name in dataset.cameras if name not in views),
        unit=calibration.unit,
        quality=quality,
        check=check if board is None else None,
        board=board,
        errors={name: errors for name, errors in found.errors.items() if name in views},
        stored=stores,
        kept=keeps and _keep(dataset, calibration),
    )


def cover(session: Path, options: CalibrateOptions) -> BoardCoverage:
    """Return the image parts that the board covered in a session, or in its recordings.

    Raises:
        SimulshotError: a session cannot be read, or is of other cameras.
    """
    dataset = Scene.open_raw(session).dataset
    corners = detect_board(open_recordings(dataset, options.recordings), options.board)
    return count_coverage(dataset, options.board, corners)


@dataclass(frozen=True, kw_only=True)
class _Candidate:
    """A calibration, and the pixels of points that pairs of cameras share, by which it is judged."""

    calibration: Calibration
    shared: SharedPoints
    board: BoardCoverage | None = None
    errors: Mapping[str, CameraErrors] = field(default_factory=dict)


def _candidate(scene: Scene, options: CalibrateOptions) -> _Candidate:
    match options.source:
        case CalibrationSource.BOARD | CalibrationSource.CHARUCO:
            return _from_board(scene.dataset, options)
        case CalibrationSource.SFM:
            fisheyes = options.lens is LensModel.FISHEYE
            calibration = calibrate_from_images(scene.motion, options.field_of_view_deg, fisheyes=fisheyes)
            views = calibrated_views(scene.dataset, calibration)
            return _Candidate(calibration=calibration, shared=_still_points(scene.features.middle, views))
        case _:
            return _from_elsewhere(scene, options.source)


def _from_board(dataset: Dataset, options: CalibrateOptions) -> _Candidate:
    """Calibrate from recordings of a board, or from the session itself; its corners judge the result."""
    board, recordings = options.board, open_recordings(dataset, options.recordings)
    if not (corners := detect_board(recordings, board)):
        _refuse_other_board(recordings[0], board)
    if isinstance(board, Checkerboard) and board.is_ambiguous:
        talk(
            f"a checkerboard of {board.shape} squares looks the same upside down: it is taken to be held the "
            "same way up in all cameras' pictures (one with an odd and an even side can be held in any way)"
        )
    lenses = lenses_of_recordings(dataset, board, _opened(options.lens_recordings), options.lens)
    calibration, errors = calibrate_from_board(recordings[0], board, corners, lenses, options.lens)
    return _Candidate(
        calibration=calibration,
        errors=errors,
        shared=shared_corners(corners),
        board=count_coverage(dataset, board, corners),
    )


def _rescaled(dataset: Dataset, found: Calibration, options: CalibrateOptions) -> Calibration:
    views = calibrated_views(dataset, found)
    if options.distance is not None:
        marks, metres = options.distance
        first, second = marked_points(views, marks, dataset.labels)
        factor, how = metres / float(np.linalg.norm(first - second)), f"a distance of {metres:g} m"
        found = in_world(found, World(np.eye(3), np.zeros(3), factor), "m", f"scale from {how}")
    elif options.scale_by_board:
        corners = detect_board(open_recordings(dataset, options.recordings), options.board)
        factor, times = metres_per_unit_by_board(views, options.board, corners)
        how = f"scale from a board, at {count(times, 'instant')}"
        found = in_world(found, World(np.eye(3), np.zeros(3), factor), "m", how)
    views = calibrated_views(dataset, found)
    if options.vertical is not None:
        world = world_of_marks(views, options.vertical, dataset.labels)
        return in_world(found, world, found.unit, "z up, ground by two points one above the other")
    if options.ground is not None:
        floor = open_recordings(dataset, (options.ground,))
        corners = detect_board(floor, options.board)
        world, times = world_of_board(views, options.board, corners, metric=found.unit == "m")
        how = f"z up, ground by a board on it in {floor[0].name}, at {count(times, 'instant')}"
        return in_world(found, world, "m", how)
    return found


def _keep(dataset: Dataset, calibration: Calibration) -> bool:
    """Store the calibration for later sessions of the rig; return False, after a message, if that fails."""
    try:
        keep_calibration(dataset, calibration)
    except BadInputError as error:
        talk(f"the calibration is not kept for later sessions: {error}")
        return False
    return True


def _refuse_other_board(dataset: Dataset, board: Board) -> None:
    """Raise BadInputError if the images show another board, or this one with columns and rows exchanged."""
    turned = f"{board.down}x{board.across}"
    detector = BoardDetector(replace(board, across=board.down, down=board.across))
    shapes: Counter[tuple[int, int]] = Counter()
    for name in dataset.cameras:
        for instant in evenly_spaced(dataset.instants(name), 4):
            grey = dataset.grey(name, instant)
            if detector.detect(grey):
                raise BadInputError(
                    f"{name} shows a board of {turned} squares, not {board.shape}", hint=f"--board {turned}"
                )
            if (seen := squares_seen(grey)) is not None:
                shapes[seen] += 1
    if not shapes:
        return
    # A board that is partly hidden seems smaller: the shape of most images counts, of these the largest.
    (across, down), times = max(shapes.items(), key=lambda one: (one[1], one[0][0] * one[0][1]))
    symmetric = "it looks the same from all four sides: use one with more squares one way"
    raise BadInputError(
        f"{count(times, 'image')} of {dataset.name} show a board without markers of {across}x{down} squares, "
        f"not {'one with markers' if board.shape == f'{across}x{down}' else board.shape}",
        hint=symmetric if across == down else f"--dictionary {PLAIN} --board {across}x{down}",
    )


def _from_elsewhere(scene: Scene, source: CalibrationSource | Path) -> _Candidate:
    """Load a calibration of the session, its rig or another session, and check it against static points."""
    dataset = scene.dataset
    if source is CalibrationSource.SESSION:
        if (calibration := dataset.session.calibration()) is None:
            raise BadInputError(f"{dataset.name} has no calibration of its own", hint="--from sfm finds one")
    elif source is CalibrationSource.STORED:
        if (stored := find_calibration(camera_modes(dataset))) is None:
            modes = (f"{name} {of.width}x{of.height}" for name, of in sorted(camera_modes(dataset).items()))
            raise BadInputError(
                f"no calibration is kept of these cameras in these modes: {', '.join(modes)}",
                hint="reconstruct calibrate keeps one; another session's can be given by its path",
            )
        calibration = stored.with_origin
    else:
        calibration = read_calibration(dataset, Path(source))
    features, (views, faults) = scene.features.middle, sound_views(dataset, calibration)
    # A calibration that is judged, and may be stored, must have no fault at all.
    refuse_faults(dataset, (), faults)
    return _Candidate(calibration=calibration, shared=_still_points(features, views))


def read_calibration(dataset: Dataset, path: Path) -> Calibration:
    """Read the calibration of another session's folder, or any calibration file that can be imported.

    Raises:
        BadInputError: there is no calibration, or that session's cameras had other image sizes.
    """
    if path.is_file() or not (path / MANIFEST).is_file():
        sizes = {name: dataset.size_on_disk(name) for name in dataset.cameras}
        return fit_calibration(read_views([("", path)], dataset.cameras), sizes, dataset.labels, talk=talk)
    (other,) = _opened([path])
    if (calibration := other.session.calibration()) is None:
        raise BadInputError(f"{path} has no calibration to give", hint="reconstruct calibrate it first")
    ours, others = camera_modes(dataset), camera_modes(other)
    # Imports know no modes: of images and videos of one size, the background decides whether they are alike.
    imported = any(one.session.manifest.origin == "imported" for one in (dataset, other))
    for name in ours.keys() & others.keys():
        same_files = imported and dataset.size_on_disk(name) == other.size_on_disk(name)
        if not same_files and ours[name] != others[name]:
            what = ", ".join(
                f"{mode.model} {mode.width}x{mode.height} in {where.name}"
                for where, mode in ((dataset, ours[name]), (other, others[name]))
            )
            raise BadInputError(
                f"{name} is not the same camera in the same mode: {what}",
                hint="calibrate in the session's own mode, from a board: --recording BOARD_SESSION",
            )
    return msgspec.structs.replace(
        calibration, source=f"{calibration.source or 'unknown'}, given by {other.name}"
    )


def open_recordings(dataset: Dataset, paths: tuple[Path, ...]) -> list[Dataset]:
    """Open the sessions that show the board to a session's cameras; without paths the session itself.

    Raises:
        BadInputError: a recording is of other cameras, or of other image sizes.
    """
    recordings = _opened(paths) or [dataset]
    for recording in recordings:
        if recording.cameras != dataset.cameras:
            raise BadInputError(
                f"{recording.name} was taken by other cameras ({', '.join(recording.cameras)})",
                hint=f"give recordings by the cameras of {dataset.name}: {', '.join(dataset.cameras)}",
            )
        refuse_other_sizes(recording, dataset, dataset.cameras)
    return recordings


def _opened(paths: Iterable[Path]) -> list[Dataset]:
    return [Scene.open_raw(path).dataset for path in paths]


def _still_points(features: Mapping[str, Features], views: Mapping[str, View]) -> SharedPoints:
    """Return points at rest that pairs of cameras share."""
    return {
        (a, b): match_features(features[a], features[b])
        for a, b in combinations([name for name in features if name in views], 2)
        if angle_deg(views[a].axis, views[b].axis) < MAX_AXIS_ANGLE_DEG
    }
