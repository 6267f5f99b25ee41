"""Calibration from a board: each lens (Zhang 2000), the rig pair by pair, then a joint bundle adjustment.

The pairwise stage accumulates errors along the rig, and each lens uses only its own images. The bundle
adjustment therefore uses all corners.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from enum import StrEnum
from itertools import accumulate, combinations

import cv2
import numpy as np

from capture_app.board.boards import MIN_CORNERS, Checkerboard
from capture_app.board.coverage import BoardCoverage, CoverageCount
from capture_app.board.detector import Board, BoardDetector, Corners
from capture_app.common.errors import BadInputError
from capture_app.common.grouping import grouped
from capture_app.common.text import count
from capture_app.console.terminal import talk
from capture_app.session.format.calibration import Calibration, LensKnowledge
from capture_app.session.format.lens import Lens
from reconstruction.common.geometry import Array, View
from reconstruction.scene.calibration.board_bundle import (
    SIMPLE,
    Adjustment,
    CameraErrors,
    Sightings,
    adjust_bundle,
    board_pose,
)
from reconstruction.scene.calibration.consistency import lens_knowledge
from reconstruction.scene.conditions import evenly_spaced
from reconstruction.scene.dataset import Dataset

MIN_BOARDS = 4
"""Minimum number of pictures of the board."""
MAX_BOARDS = 40
"""Maximum number of pictures of the board that are used."""


FISHEYE_PX = 0.1
"""RMS residual of the perspective model above which the fisheye model is tried."""
CLEARLY_BETTER = 2.0
"""Standard deviations of Wilcoxon's signed ranks (1945) of both models' squared residuals, by pictures, from
which a lens is a fisheye. Eight real perspective lenses have at most 1.0, five rendered fisheyes at least
2.3. Ranks, as a single picture in which one model finds a wrong pose outweighs the others."""


class LensModel(StrEnum):
    """The lens model to fit: perspective unless its residuals demand a fisheye, or the one that is given."""

    AUTO = "auto"
    PERSPECTIVE = "perspective"
    FISHEYE = "fisheye"


def calibrate_lens(
    name: str,
    size: tuple[int, int],
    board: Board,
    seen: Sequence[Corners],
    model: LensModel = LensModel.AUTO,
) -> Lens:
    """Calibrate the lens of a camera of this size (px) from the board's corners in its images.

    Raises:
        BadInputError: it saw the board too rarely.
    """
    if len(seen) < MIN_BOARDS:
        raise BadInputError(
            f"{name} shows the board in {count(len(seen), 'image')}; {MIN_BOARDS} are needed",
            hint="record the board from more places; check --board, --square-mm and --dictionary",
        )
    seen = evenly_spaced(seen, MAX_BOARDS)
    points = [board.places[sorted(corners)] for corners in seen]
    pixels = [_pixels(corners, sorted(corners)) for corners in seen]
    plain = None
    if model is not LensModel.FISHEYE:
        start = np.eye(3), np.zeros(5)
        with suppress(cv2.error):
            error_px, matrix, distortion, _, _ = cv2.calibrateCamera(
                points, pixels, size, *start, flags=cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
            )
            plain = Lens(np.asarray(matrix), np.asarray(distortion).ravel()[:5])
        if plain is not None and (error_px <= FISHEYE_PX or model is LensModel.PERSPECTIVE):
            return plain
    sightings: Sightings = {
        (name, moment): (at.astype(float), there.astype(float))
        for moment, (at, there) in enumerate(zip(points, pixels, strict=True))
    }
    fits = []
    # Fields of view along the longer side from which the fisheye model is fitted.
    for degrees in (100.0, 135.0, 170.0):
        matrix = np.diag([max(size) / np.radians(degrees)] * 2 + [1.0])
        matrix[:2, 2] = (np.array(size) - 1) / 2
        fits.append(_adjusted_lens(size, Lens(matrix, np.zeros(4), True), sightings))
    lens, squares = min(fits, key=lambda fit: fit[1].sum())
    if plain is not None:
        plain, plain_squares = _adjusted_lens(size, plain, sightings)
        if _signed_ranks(plain_squares - squares) < CLEARLY_BETTER:
            return plain
        corners = sum(map(len, pixels))
        fisheye_px, plain_px = (
            float(np.sqrt(errors.sum() / 2 / corners)) for errors in (squares, plain_squares)
        )
        talk(
            f"{name} has a fisheye: the corners fit that model within {fisheye_px:.2f} px, and a perspective "
            f"lens within {plain_px:.2f} px"
        )
    return lens


def _signed_ranks(differences: Array) -> float:
    """Return the sum of the differences' signed ranks in its standard deviations if none is expected."""
    ranks = 1.0 + np.abs(differences).argsort().argsort()
    return float((np.sign(differences) * ranks).sum() / np.sqrt((ranks**2).sum()))


def _adjusted_lens(size: tuple[int, int], lens: Lens, sightings: Sightings) -> tuple[Lens, Array]:
    """Return a lens fitted to one camera's corners, and each picture's sum of squared residuals, px^2."""
    ((name, _), *_) = sightings
    views = {name: View.from_lens(lens, size, np.eye(3), np.zeros(3))}
    for terms in ({0, 1, 2, 3}, SIMPLE, {*range(8 if lens.is_fisheye else 9)}):
        adjustment = Adjustment(views, sightings, {name: terms})
        try:
            values = adjustment.solve(adjustment.start())
        except (cv2.error, np.linalg.LinAlgError):
            # No lens was found.
            return lens, np.full(len(sightings), 1e9)
        views = adjustment.views_at(values)
    return views[name].lens, adjustment.squares(values)


def lenses_of_recordings(
    dataset: Dataset, board: Board, recordings: Sequence[Dataset], model: LensModel = LensModel.AUTO
) -> dict[str, Lens]:
    """Calibrate lenses of a session's cameras from recordings in which single cameras see the board.

    Raises:
        BadInputError: a recording is of none of these cameras, of another size, or shows too little.
    """
    seen: dict[str, list[Corners]] = {}
    for recording in recordings:
        if not (shared := [name for name in recording.cameras if name in dataset.cameras]):
            raise BadInputError(
                f"{recording.name} was taken by other cameras ({', '.join(recording.cameras)})",
                hint=f"give a recording of {', '.join(dataset.cameras)}",
            )
        refuse_other_sizes(recording, dataset, shared)
        for name in shared:
            detector = BoardDetector(board)
            images = (recording.grey(name, instant) for instant in recording.instants(name))
            seen.setdefault(name, []).extend(filter(None, map(detector.detect, images)))
    return {
        name: calibrate_lens(name, dataset.size(name), board, corners, model)
        for name, corners in seen.items()
    }


def refuse_other_sizes(recording: Dataset, dataset: Dataset, cameras: Sequence[str]) -> None:
    """Raise BadInputError if a recording's images of these cameras have another size."""
    for name in cameras:
        if recording.size(name) != dataset.size(name):
            sizes = ["x".join(map(str, source.size(name))) for source in (recording, dataset)]
            raise BadInputError(
                f"{name} has pictures of {sizes[0]} in {recording.name}, of {sizes[1]} in {dataset.name}",
                hint="record the board in the mode that is used later: another may show another part",
            )


BoardCorners = dict[tuple[str, int], Corners]
"""Pixels of the board's corners, by camera and moment; moments are instants counted over all recordings."""


def detect_board(recordings: Sequence[Dataset], board: Board) -> BoardCorners:
    """Detect the board in every image; images with fewer than MIN_CORNERS are left out."""
    finders = {camera: BoardDetector(board) for camera in recordings[0].cameras}
    first_moments = accumulate((len(recording.instants_ns) for recording in recordings), initial=0)
    return {
        (camera, first + instant): corners
        for recording, first in zip(recordings, first_moments, strict=False)
        for camera in recording.cameras
        for instant in recording.instants(camera)
        if (corners := finders[camera].detect(recording.grey(camera, instant)))
    }


def count_coverage(dataset: Dataset, board: Board, corners: BoardCorners) -> BoardCoverage:
    """Count which parts of the cameras' images the board has covered."""
    counted = CoverageCount(board, {name: dataset.size(name) for name in dataset.cameras})
    for seen in corners_by_moment(corners).values():
        counted.add(seen)
    return counted.coverage()


def corners_by_moment(corners: BoardCorners) -> dict[int, dict[str, Corners]]:
    """Group corners by moment, then camera, in the order of moments."""
    by_moment = grouped((moment, (camera, seen)) for (camera, moment), seen in corners.items())
    return {moment: dict(by_moment[moment]) for moment in sorted(by_moment)}


def shared_corners(corners: BoardCorners) -> dict[tuple[str, str], tuple[Array, Array]]:
    """Return, for pairs of cameras, the pixels of corners that both see at the same instant."""
    shared = grouped(
        ((a, b), (seen[a][i], seen[b][i]))
        for seen in corners_by_moment(corners).values()
        for a, b in combinations(sorted(seen), 2)
        for i in sorted(seen[a].keys() & seen[b].keys())
    )
    pixels = {pair: np.stack(corners, axis=1) for pair, corners in shared.items()}
    return {pair: (at_a, at_b) for pair, (at_a, at_b) in pixels.items()}


def calibrate_from_board(
    dataset: Dataset,
    board: Board,
    corners: BoardCorners,
    known: Mapping[str, Lens] | None = None,
    model: LensModel = LensModel.AUTO,
) -> tuple[Calibration, Mapping[str, CameraErrors]]:
    """Calibrate every lens, place the cameras by boards that they share, then adjust everything together.

    `known`: lenses that are calibrated already and stay fixed. Returns the 95 % errors by camera, too.

    Raises:
        BadInputError: the board was seen too rarely, or a camera shares no boards with the others.
    """
    places, known = board.places, known or {}
    lenses = {
        camera: known[camera]
        if camera in known
        else calibrate_lens(
            camera,
            dataset.size(camera),
            board,
            [corners[key] for key in sorted(corners) if key[0] == camera],
            model,
        )
        for camera in dataset.cameras
    }
    poses = _rig_poses(dataset, places, corners, lenses)
    views = {name: View.from_lens(lens, dataset.size(name), *poses[name]) for name, lens in lenses.items()}
    used = _bundle_moments(corners)
    sightings = {
        (name, moment): (
            places[sorted(own_corners)].astype(float),
            _pixels(own_corners, sorted(own_corners)).astype(float),
        )
        for (name, moment), own_corners in corners.items()
        if moment in used
    }
    bundle = adjust_bundle(views, sightings, frozenset(known))
    if bundle.apart_px is not None:
        talk(
            f"corners fit all cameras together within {bundle.rms_px:.2f} px, each alone within "
            f"{bundle.apart_px:.2f} px: the board moved between the cameras' images, or is bent. Lenses are "
            "from each camera's own images; hold the board still for the poses"
        )
    kind = "checkerboard" if isinstance(board, Checkerboard) else "ChArUco board"
    own = f", lenses of {', '.join(known)} from recordings of their own" if known else ""
    percent = [errors.focal_percent for name, errors in bundle.errors.items() if name not in known]
    sure = lens_knowledge([value / 100 for value in percent]) if percent else LensKnowledge()
    cameras = {
        name: replace(view, seen_deg=_seen_deg(view, [at for who, at in corners.items() if who[0] == name]))
        for name, view in bundle.views.items()
    }
    calibration = Calibration(
        cameras={name: view.to_calibration() for name, view in cameras.items()},
        unit="m",
        source=f"{kind} in {len(corners)} images of {dataset.name}{own}{sure.text and ', '}{sure.text}",
        lenses=sure,
    )
    return calibration, bundle.errors


def _seen_deg(view: View, seen: Sequence[Corners]) -> float:
    """Return the angle off the axis of the outermost corner, degrees."""
    rays = view.lens.rays(np.concatenate([[*corners.values()] for corners in seen]))
    return float(np.degrees(np.arctan(np.hypot(rays[:, 0], rays[:, 1]).max())))


def _bundle_moments(corners: BoardCorners) -> set[int]:
    """Choose moments for the bundle adjustment: a limited number of each camera pair and each camera."""
    groups = grouped(
        (frozenset(who), moment)
        for moment, seen in corners_by_moment(corners).items()
        for who in [*combinations(seen, 2), *((name,) for name in seen)]
    )
    # The adjustment's time is cubic in its moments.
    chosen = {k for moments in groups.values() for k in evenly_spaced(moments, 20)}
    return set(evenly_spaced(sorted(chosen), 150))


def _pixels(seen: dict[int, Array], ids: list[int]) -> Array:
    return np.array([seen[i] for i in ids], np.float32)


def _rig_poses(
    dataset: Dataset, places: Array, corners: BoardCorners, lenses: Mapping[str, Lens]
) -> dict[str, tuple[Array, Array]]:
    """Return `cam_from_rig`, chained from the first camera through those that share most boards."""
    shared = grouped(
        (frozenset((a, b)), (k, ids))
        for k, seen in corners_by_moment(corners).items()
        for a, b in combinations(seen, 2)
        if len(ids := sorted(seen[a].keys() & seen[b].keys())) >= MIN_CORNERS
    )
    poses = {dataset.cameras[0]: (np.eye(3), np.zeros(3))}
    while left := [b for b in dataset.cameras if b not in poses]:
        links = [(len(shared.get(frozenset((a, b)), ())), a, b) for a in poses for b in left]
        shared_boards, a, b = max(links, key=lambda link: link[0])
        if shared_boards < MIN_BOARDS:
            raise BadInputError(
                f"{b} and {a} show the board together at {count(shared_boards, 'instant')}; {MIN_BOARDS} are "
                "needed",
                hint="hold the board where neighbouring cameras both see it",
            )
        together = shared[frozenset((a, b))][:MAX_BOARDS]
        in_a, in_b = ([_pixels(corners[name, k], ids) for k, ids in together] for name in (a, b))
        rotation, translation = relative_pose(
            [places[ids] for _, ids in together], (in_a, in_b), (lenses[a], lenses[b])
        )
        poses[b] = rotation @ poses[a][0], rotation @ poses[a][1] + translation
    return poses


def relative_pose(
    points: list[Array], pixels: tuple[list[Array], list[Array]], lenses: tuple[Lens, Lens]
) -> tuple[Array, Array]:
    """Return rotation (3, 3) and translation (3,) from the first camera to the second.

    They are the means over the half of the boards that agree best. OpenCV's stereoCalibrate is not used: it
    starts from a median of rotation vectors, which fails near half a turn.
    """
    rotations, translations = [], []
    for at, *seen in zip(points, *pixels, strict=True):
        (of_a, move_a), (of_b, move_b) = map(board_pose, lenses, (at, at), seen)
        rotations.append(of_b @ of_a.T)
        translations.append(move_b - of_b @ of_a.T @ move_a)
    every = np.array(rotations)
    apart = np.linalg.norm(every[:, None] - every[None], axis=(2, 3))
    agreeing = np.argsort(apart[int(apart.sum(0).argmin())])[: max(1, (len(every) + 1) // 2)]
    left, _, right = np.linalg.svd(every[agreeing].sum(0))
    return left @ right, np.array(translations)[agreeing].mean(0)
