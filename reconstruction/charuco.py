"""Calibration from a recording of a ChArUco board: every camera by itself, then the rig pair by pair."""

from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from capture_app.errors import BadInputError
from capture_app.session.calibration import Calibration, CameraCalibration
from reconstruction.dataset import Dataset
from reconstruction.geometry import Array

FEWEST_CORNERS = 6
FEWEST_BOARDS = 4
MOST_BOARDS = 40


@dataclass(frozen=True)
class Board:
    """Squares across and down, lengths in m, and the name of the markers' dictionary (as `4X4_50`)."""

    across: int
    down: int
    square_m: float
    marker_m: float
    dictionary: str

    def made(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's board. Raises BadInputError where there is no such one."""
        kind = getattr(cv2.aruco, f"DICT_{self.dictionary.upper()}", None)
        if kind is None:
            raise BadInputError(f"no dictionary {self.dictionary!r}", hint="as 4X4_50, 5X5_100, 6X6_250")
        if not 0 < self.marker_m < self.square_m:
            raise BadInputError("a board's markers are smaller than its squares")
        words = cv2.aruco.getPredefinedDictionary(kind)
        return cv2.aruco.CharucoBoard((self.across, self.down), self.square_m, self.marker_m, words)


Corners = dict[tuple[str, int], dict[int, Array]]
"""By camera and instant, pixels (2,) of the board's corners by their number."""


def find_corners(dataset: Dataset, board: Board) -> Corners:
    """Look for the board in every image; images that show less than FEWEST_CORNERS are left out."""
    detector = cv2.aruco.CharucoDetector(board.made())
    found: Corners = {}
    for camera in dataset.cameras:
        for instant in dataset.instants(camera):
            at, ids, _, _ = detector.detectBoard(dataset.grey(camera, instant))
            if ids is not None and len(ids) >= FEWEST_CORNERS:
                pixels = np.asarray(at, float).reshape(-1, 2)
                found[camera, instant] = dict(zip(np.ravel(ids).tolist(), pixels, strict=True))
    return found


def shared_corners(corners: Corners) -> dict[tuple[str, str], tuple[Array, Array]]:
    """For pairs of cameras, the pixels of corners that both see at the same instant."""
    shared: dict[tuple[str, str], tuple[list[Array], list[Array]]] = {}
    for (a, at_a), (b, at_b) in combinations(sorted(corners), 2):
        if a == b or at_a != at_b:
            continue
        first, second = corners[a, at_a], corners[b, at_b]
        both = sorted(first.keys() & second.keys())
        kept = shared.setdefault((a, b), ([], []))
        kept[0].extend(first[i] for i in both)
        kept[1].extend(second[i] for i in both)
    return {pair: (np.array(x), np.array(y)) for pair, (x, y) in shared.items() if x}


def calibrate(dataset: Dataset, board: Board, corners: Corners) -> Calibration:
    """Intrinsics of every camera (Zhang 2000), then each camera's place from boards it shares with another.

    Raises:
        BadInputError: the board was seen too rarely, or a camera shares no boards with the others.
    """
    places = np.asarray(board.made().getChessboardCorners(), np.float32)
    lenses: dict[str, tuple[Array, Array]] = {}
    for camera in dataset.cameras:
        seen = [k for name, k in sorted(corners) if name == camera]
        if len(seen) < FEWEST_BOARDS:
            raise BadInputError(
                f"{camera} shows the board in {len(seen)} images, and it takes {FEWEST_BOARDS}",
                hint="record the board from more places; check --board, --square-mm and --dictionary",
            )
        seen = [seen[round(i)] for i in np.linspace(0, len(seen) - 1, min(len(seen), MOST_BOARDS))]
        points = [places[sorted(corners[camera, k])] for k in seen]
        pixels = [_pixels(corners[camera, k], sorted(corners[camera, k])) for k in seen]
        # A small or flat set of boards cannot tell the higher terms of distortion.
        flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
        _, matrix, distortion, _, _ = cv2.calibrateCamera(
            points, pixels, dataset.size(camera), np.eye(3), np.zeros(5), flags=flags
        )
        lenses[camera] = np.asarray(matrix), np.asarray(distortion).ravel()[:5]
    poses = _poses(dataset, places, corners, lenses)
    cameras = {name: _record(dataset.size(name), *lenses[name], *poses[name]) for name in dataset.cameras}
    return Calibration(
        cameras=cameras, unit="m", source=f"ChArUco board in {len(corners)} images of {dataset.name}"
    )


def _pixels(seen: dict[int, Array], ids: list[int]) -> Array:
    return np.array([seen[i] for i in ids], np.float32)


def _poses(
    dataset: Dataset, places: Array, corners: Corners, lenses: dict[str, tuple[Array, Array]]
) -> dict[str, tuple[Array, Array]]:
    """`cam_from_rig`: the first camera is the rig; each other is joined to the one it shares most with."""
    shared: dict[frozenset[str], list[tuple[int, list[int]]]] = {}
    for a, b in combinations(dataset.cameras, 2):
        for k in range(len(dataset.instants_ns)):
            ids = sorted(corners.get((a, k), {}).keys() & corners.get((b, k), {}).keys())
            if len(ids) >= FEWEST_CORNERS:
                shared.setdefault(frozenset((a, b)), []).append((k, ids))
    first = dataset.cameras[0]
    poses = {first: (np.eye(3), np.zeros(3))}
    while len(poses) < len(dataset.cameras):
        links = [
            (len(shared.get(frozenset((a, b)), ())), a, b)
            for a in poses
            for b in dataset.cameras
            if b not in poses
        ]
        count, a, b = max(links, key=lambda link: link[0])
        if count < FEWEST_BOARDS:
            raise BadInputError(
                f"{b} and {a} show the board together in {count} instants, and it takes {FEWEST_BOARDS}",
                hint="hold the board where neighbouring cameras both see it",
            )
        together = shared[frozenset((a, b))][:MOST_BOARDS]
        in_a, in_b = ([_pixels(corners[name, k], ids) for k, ids in together] for name in (a, b))
        found = cv2.stereoCalibrate(
            [places[ids] for _, ids in together],
            in_a,
            in_b,
            *lenses[a],
            *lenses[b],
            dataset.size(a),
            flags=cv2.CALIB_FIX_INTRINSIC,
        )
        rotation, translation = np.asarray(found[5]), np.asarray(found[6]).ravel()
        poses[b] = rotation @ poses[a][0], rotation @ poses[a][1] + translation
    return poses


def _record(
    size: tuple[int, int], matrix: Array, distortion: Array, rotation: Array, translation: Array
) -> CameraCalibration:
    return CameraCalibration(
        width=size[0],
        height=size[1],
        fx=float(matrix[0, 0]),
        fy=float(matrix[1, 1]),
        cx=float(matrix[0, 2]),
        cy=float(matrix[1, 2]),
        rotation=tuple(tuple(float(v) for v in row) for row in rotation),  # type: ignore[arg-type]
        translation=tuple(float(v) for v in translation),  # type: ignore[arg-type]
        distortion=tuple(float(v) for v in distortion),
    )
