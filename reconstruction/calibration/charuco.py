"""Calibration by a ChArUco board: detected in pictures, then each camera's intrinsics, then the rig.

The board may be printed light or dark, and seen from its front or its back.
"""

from collections.abc import Sequence
from itertools import combinations

import cv2
import numpy as np

from capture_app.board.charuco import MIN_CORNERS, CharucoBoard
from capture_app.board.coverage import BoardCoverage, CoverageCount
from capture_app.board.detector import BoardDetector, Corners
from capture_app.errors import BadInputError
from capture_app.session.format.calibration import Calibration
from capture_app.text import count
from reconstruction.calibration.board_bundle import adjust_bundle
from reconstruction.common.geometry import Array, View
from reconstruction.session.dataset import Dataset
from reconstruction.session.frame_offset import evenly_spread

BoardCorners = dict[tuple[str, int], Corners]
"""By camera and moment, pixels of the board's corners; moments are instants, counted over all recordings."""


def detect_board(recordings: Sequence[Dataset], board: CharucoBoard) -> BoardCorners:
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


def count_coverage(dataset: Dataset, board: CharucoBoard, corners: BoardCorners) -> BoardCoverage:
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


MIN_BOARDS = 4
MAX_BOARDS = 40
BUNDLE_MOMENTS_EACH, BUNDLE_MOMENTS = 20, 150
"""Moments of each camera and pair, and in all, that are adjusted together: the time grows with their cube."""


def calibrate_from_board(dataset: Dataset, board: CharucoBoard, corners: BoardCorners) -> Calibration:
    """Intrinsics of every camera (Zhang 2000), each camera's place from boards it shares, then all together.

    Raises:
        BadInputError: the board was seen too rarely, or a camera shares no boards with the others.
    """
    places = board.places
    lenses: dict[str, tuple[Array, Array]] = {}
    for camera in dataset.cameras:
        seen = [k for name, k in sorted(corners) if name == camera]
        if len(seen) < MIN_BOARDS:
            raise BadInputError(
                f"{camera} shows the board in {count(len(seen), 'image')}; {MIN_BOARDS} are needed",
                hint="record the board from more places; check --board, --square-mm and --dictionary",
            )
        seen = evenly_spread(seen, MAX_BOARDS)
        points = [places[sorted(corners[camera, k])] for k in seen]
        pixels = [_pixels(corners[camera, k], sorted(corners[camera, k])) for k in seen]
        # Few boards, or boards at one angle, do not determine the higher terms of distortion.
        flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
        _, matrix, distortion, _, _ = cv2.calibrateCamera(
            points, pixels, dataset.size(camera), np.eye(3), np.zeros(5), flags=flags
        )
        lenses[camera] = np.asarray(matrix), np.asarray(distortion).ravel()[:5]
    poses = _rig_poses(dataset, places, corners, lenses)
    views = {name: View(*dataset.size(name), *lenses[name], *poses[name]) for name in dataset.cameras}
    used = _bundle_moments(corners)
    sightings = {
        (name, moment): (places[sorted(found)].astype(float), _pixels(found, sorted(found)).astype(float))
        for (name, moment), found in corners.items()
        if moment in used
    }
    views = adjust_bundle(views, sightings)
    return Calibration(
        cameras={name: view.to_calibration() for name, view in views.items()},
        unit="m",
        source=f"ChArUco board in {len(corners)} images of {dataset.name}",
    )


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
        known = *lenses[a], *lenses[b], dataset.size(a)
        found = cv2.stereoCalibrate(points, in_a, in_b, *known, flags=cv2.CALIB_FIX_INTRINSIC)
        rotation, translation = np.asarray(found[5]), np.asarray(found[6]).ravel()
        poses[b] = rotation @ poses[a][0], rotation @ poses[a][1] + translation
    return poses
