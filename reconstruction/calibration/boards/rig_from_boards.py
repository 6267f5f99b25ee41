"""Calibration by a board: detected in pictures, then each camera's intrinsics, then the rig.

A board with markers may be printed light or dark, and seen from its front or its back.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations

import cv2
import numpy as np

from capture_app.board.charuco import MIN_CORNERS
from capture_app.board.checkerboard import Checkerboard
from capture_app.board.coverage import BoardCoverage, CoverageCount
from capture_app.board.detector import Board, BoardDetector, Corners
from capture_app.errors import BadInputError
from capture_app.session.format.calibration import Calibration
from capture_app.text import count
from reconstruction.calibration.boards.board_bundle import adjust_bundle
from reconstruction.calibration.boards.lenses import MAX_BOARDS, MIN_BOARDS, Lens, calibrate_lens
from reconstruction.common.geometry import Array, View
from reconstruction.session.dataset import Dataset
from reconstruction.session.frame_offset import evenly_spread

BoardCorners = dict[tuple[str, int], Corners]
"""By camera and moment, pixels of the board's corners; moments are instants, counted over all recordings."""


def detect_board(recordings: Sequence[Dataset], board: Board) -> BoardCorners:
    """Detect the board in every image; images with fewer than MIN_CORNERS are left out."""
    found: BoardCorners = {}
    finders = {camera: BoardDetector(board) for camera in recordings[0].cameras}
    before = 0
    for recording in recordings:
        for camera in recording.cameras:
            for instant in recording.instants(camera):
                corners = finders[camera].detect(recording.grey(camera, instant))
                if corners:
                    found[camera, before + instant] = corners
        before += len(recording.instants_ns)
    return found


def count_coverage(dataset: Dataset, board: Board, corners: BoardCorners) -> BoardCoverage:
    """What the board has covered in recordings of this dataset's cameras."""
    counted = CoverageCount(board, {name: dataset.size(name) for name in dataset.cameras})
    for seen in corners_by_moment(corners).values():
        counted.add(seen)
    return counted.coverage()


def corners_by_moment(corners: BoardCorners) -> dict[int, dict[str, Corners]]:
    """What each camera saw of the board at each moment, in the moments' order."""
    found: dict[int, dict[str, Corners]] = {}
    for (camera, moment), seen in corners.items():
        found.setdefault(moment, {})[camera] = seen
    return dict(sorted(found.items()))


def shared_corners(corners: BoardCorners) -> dict[tuple[str, str], tuple[Array, Array]]:
    """For pairs of cameras, the pixels of corners that both see at the same instant."""
    shared: dict[tuple[str, str], tuple[list[Array], list[Array]]] = {}
    for seen in corners_by_moment(corners).values():
        for a, b in combinations(sorted(seen), 2):
            both = sorted(seen[a].keys() & seen[b].keys())
            kept = shared.setdefault((a, b), ([], []))
            kept[0].extend(seen[a][i] for i in both)
            kept[1].extend(seen[b][i] for i in both)
    return {pair: (np.array(x), np.array(y)) for pair, (x, y) in shared.items() if x}


BUNDLE_MOMENTS_EACH, BUNDLE_MOMENTS = 20, 150
"""Moments of each camera and pair, and in all, that are adjusted together: the time grows with their cube."""


def calibrate_from_board(
    dataset: Dataset, board: Board, corners: BoardCorners, known: Mapping[str, Lens] | None = None
) -> Calibration:
    """Intrinsics of every camera, each camera's place from boards it shares, then all together.

    `known`: lenses that were calibrated before, and stay.

    Raises:
        BadInputError: the board was seen too rarely, or a camera shares no boards with the others.
    """
    places, known = board.places, known or {}
    lenses = {
        camera: known[camera]
        if camera in known
        else calibrate_lens(camera, dataset.size(camera), board, _of_camera(corners, camera))
        for camera in dataset.cameras
    }
    poses = _rig_poses(dataset, places, corners, lenses)
    views = {name: View(*dataset.size(name), *lenses[name], *poses[name]) for name in dataset.cameras}
    used = _bundle_moments(corners)
    sightings = {
        (name, moment): (places[sorted(found)].astype(float), _pixels(found, sorted(found)).astype(float))
        for (name, moment), found in corners.items()
        if moment in used
    }
    views = adjust_bundle(views, sightings, frozenset(known))
    return Calibration(
        cameras={name: view.to_calibration() for name, view in views.items()},
        unit="m",
        source=_source(dataset, board, corners, known),
    )


def _source(dataset: Dataset, board: Board, corners: BoardCorners, known: Mapping[str, Lens]) -> str:
    kind = "checkerboard" if isinstance(board, Checkerboard) else "ChArUco board"
    lenses = f", lenses of {', '.join(known)} from recordings of their own" if known else ""
    return f"{kind} in {len(corners)} images of {dataset.name}{lenses}"


def _of_camera(corners: BoardCorners, camera: str) -> list[Corners]:
    return [corners[key] for key in sorted(corners) if key[0] == camera]


def _bundle_moments(corners: BoardCorners) -> set[int]:
    """Moments for the bundle adjustment: some of each pair of cameras and of each camera, not too many."""
    groups: dict[frozenset[str], list[int]] = {}
    for moment, seen in corners_by_moment(corners).items():
        for who in [*combinations(seen, 2), *((name,) for name in seen)]:
            groups.setdefault(frozenset(who), []).append(moment)
    chosen = {k for moments in groups.values() for k in evenly_spread(moments, BUNDLE_MOMENTS_EACH)}
    return set(evenly_spread(sorted(chosen), BUNDLE_MOMENTS))


def _pixels(seen: dict[int, Array], ids: list[int]) -> Array:
    return np.array([seen[i] for i in ids], np.float32)


def _rig_poses(
    dataset: Dataset, places: Array, corners: BoardCorners, lenses: dict[str, tuple[Array, Array]]
) -> dict[str, tuple[Array, Array]]:
    """`cam_from_rig`: the first camera is the rig; each other is joined to the one it shares most with."""
    shared: dict[frozenset[str], list[tuple[int, list[int]]]] = {}
    for k, seen in corners_by_moment(corners).items():
        for a, b in combinations(seen, 2):
            ids = sorted(seen[a].keys() & seen[b].keys())
            if len(ids) >= MIN_CORNERS:
                shared.setdefault(frozenset((a, b)), []).append((k, ids))
    first = dataset.cameras[0]
    poses = {first: (np.eye(3), np.zeros(3))}
    while len(poses) < len(dataset.cameras):
        left = [b for b in dataset.cameras if b not in poses]
        links = [(len(shared.get(frozenset((a, b)), ())), a, b) for a in poses for b in left]
        most, a, b = max(links, key=lambda link: link[0])
        if most < MIN_BOARDS:
            raise BadInputError(
                f"{b} and {a} show the board together at {count(most, 'instant')}; {MIN_BOARDS} are needed",
                hint="hold the board where neighbouring cameras both see it",
            )
        together = shared[frozenset((a, b))][:MAX_BOARDS]
        in_a, in_b = ([_pixels(corners[name, k], ids) for k, ids in together] for name in (a, b))
        points = [places[ids] for _, ids in together]
        rotation, translation = _relative_pose(points, (in_a, in_b), (lenses[a], lenses[b]))
        poses[b] = rotation @ poses[a][0], rotation @ poses[a][1] + translation
    return poses


def _relative_pose(
    points: list[Array], pixels: tuple[list[Array], list[Array]], lenses: tuple[Lens, Lens]
) -> tuple[Array, Array]:
    """Rotation (3, 3) and translation (3,) from one camera to the other: of the boards that agree, the mean.

    OpenCV's stereoCalibrate begins with a median of rotation vectors, which fails where they are half a turn.
    """
    rotations, translations = [], []
    for at, in_a, in_b in zip(points, *pixels, strict=True):
        (of_a, move_a), (of_b, move_b) = (
            _board_pose(at, seen, lens) for seen, lens in zip((in_a, in_b), lenses, strict=True)
        )
        rotations.append(of_b @ of_a.T)
        translations.append(move_b - of_b @ of_a.T @ move_a)
    every = np.array(rotations)
    apart = np.linalg.norm(every[:, None] - every[None], axis=(2, 3))
    agreeing = np.argsort(apart[int(apart.sum(0).argmin())])[: max(1, (len(every) + 1) // 2)]
    left, _, right = np.linalg.svd(every[agreeing].sum(0))
    return left @ right, np.array(translations)[agreeing].mean(0)


def _board_pose(points: Array, pixels: Array, lens: Lens) -> tuple[Array, Array]:
    _, turn, move = cv2.solvePnP(points, pixels, *lens)
    return cv2.Rodrigues(turn)[0], np.asarray(move).ravel()
