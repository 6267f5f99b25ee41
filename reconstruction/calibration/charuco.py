"""Calibration by a ChArUco board: detected in pictures, then each camera's intrinsics, then the rig.

The board may be printed light or dark, and seen from its front or its back.
"""

from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from capture_app.errors import BadInputError
from capture_app.session.format.calibration import Calibration
from reconstruction.common.geometry import Array, View
from reconstruction.session.dataset import Dataset
from reconstruction.session.frame_offset import evenly_spread

MIN_CORNERS = 6
MAX_BEND_SHARE = 0.03
"""Corners further from a flat board than this share of its size were misread; a lens bends it less."""


@dataclass(frozen=True)
class CharucoBoard:
    """Squares across and down, lengths in m, and the name of the markers' dictionary (as `4X4_50`)."""

    across: int
    down: int
    square_m: float
    marker_m: float
    dictionary: str

    def to_opencv(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's board. Raises BadInputError for an unknown dictionary or impossible sizes."""
        kind = getattr(cv2.aruco, f"DICT_{self.dictionary.upper()}", None)
        if kind is None:
            raise BadInputError(f"unknown dictionary {self.dictionary!r}", hint="such as 4X4_50 or 6X6_250")
        if not 0 < self.marker_m < self.square_m:
            raise BadInputError("a board's markers must be smaller than its squares")
        words = cv2.aruco.getPredefinedDictionary(kind)
        return cv2.aruco.CharucoBoard((self.across, self.down), self.square_m, self.marker_m, words)


BoardCorners = dict[tuple[str, int], dict[int, Array]]
"""By camera and instant, pixels (2,) of the board's corners by their number."""


@dataclass(frozen=True)
class BoardAppearance:
    """How a picture is changed before the board is detected in it.

    `dark`: brightness turned round, for boards printed white on black. `back`: left and right turned round,
    for the back of a board that was printed on both sides or on glass, as cameras on two sides of it need.
    """

    dark: bool = False
    back: bool = False


class BoardDetector:
    """Detects a board; the appearance it had last time is tried first."""

    def __init__(self, board: CharucoBoard) -> None:
        """Raises BadInputError for an unknown dictionary or impossible sizes."""
        made = board.to_opencv()
        self._detector = cv2.aruco.CharucoDetector(made)
        self._places = np.asarray(made.getChessboardCorners(), np.float64)[:, :2]
        self._appearances = [BoardAppearance(dark, back) for dark in (False, True) for back in (False, True)]

    def detect(self, grey: Array) -> dict[int, Array]:
        """Pixels of the board's corners by their number in a picture (uint8); none = it is not there."""
        for appearance in self._appearances:
            found = self._detect_as(appearance, grey)
            if found:
                self._appearances.remove(appearance)
                self._appearances.insert(0, appearance)
                return found
        return {}

    def _detect_as(self, appearance: BoardAppearance, grey: Array) -> dict[int, Array]:
        seen = 255 - grey if appearance.dark else grey
        if appearance.back:
            seen = np.ascontiguousarray(seen[:, ::-1])
        at, numbers, _, _ = self._detector.detectBoard(seen)
        if numbers is None or len(numbers) < MIN_CORNERS:
            return {}
        ids, pixels = np.ravel(numbers), np.asarray(at, float).reshape(-1, 2)
        if not is_flat_board(self._places[ids], pixels):
            return {}
        if appearance.back:
            pixels[:, 0] = grey.shape[1] - 1 - pixels[:, 0]
        return dict(zip(ids.tolist(), pixels, strict=True))


def is_flat_board(places: Array, pixels: Array) -> bool:
    """Whether pixels (n, 2) are those of corners at these places (n, 2; m) of a flat board, not mirrored."""
    if np.linalg.matrix_rank(places - places.mean(0)) < 2:
        return False
    matrix, _ = cv2.findHomography(places, pixels)
    if matrix is None:
        return False
    seen = np.column_stack([places, np.ones(len(places))]) @ matrix.T
    # The board's x and y are to the right and down, as the picture's are: else it is read mirrored.
    turned = np.linalg.det(matrix) * seen[:, 2]
    if turned.min() <= 0:
        return False
    error = np.linalg.norm(seen[:, :2] / seen[:, 2:] - pixels, axis=1)
    size = float(np.linalg.norm(np.ptp(pixels, axis=0)))
    return bool(error.max() < MAX_BEND_SHARE * size + 1)


def detect_board(dataset: Dataset, board: CharucoBoard) -> BoardCorners:
    """Detect the board in every image; images with fewer than MIN_CORNERS are left out."""
    found: BoardCorners = {}
    for camera in dataset.cameras:
        finder = BoardDetector(board)
        for instant in dataset.instants(camera):
            corners = finder.detect(dataset.grey(camera, instant))
            if corners:
                found[camera, instant] = corners
    return found


def shared_corners(corners: BoardCorners) -> dict[tuple[str, str], tuple[Array, Array]]:
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


MIN_BOARDS = 4
MAX_BOARDS = 40


def calibrate_from_board(dataset: Dataset, board: CharucoBoard, corners: BoardCorners) -> Calibration:
    """Intrinsics of every camera (Zhang 2000), then each camera's place from boards it shares with another.

    Raises:
        BadInputError: the board was seen too rarely, or a camera shares no boards with the others.
    """
    places = np.asarray(board.to_opencv().getChessboardCorners(), np.float32)
    lenses: dict[str, tuple[Array, Array]] = {}
    for camera in dataset.cameras:
        seen = [k for name, k in sorted(corners) if name == camera]
        if len(seen) < MIN_BOARDS:
            raise BadInputError(
                f"{camera} shows the board in {len(seen)} images; {MIN_BOARDS} are needed",
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
    return Calibration(
        cameras={name: view.to_calibration() for name, view in views.items()},
        unit="m",
        source=f"ChArUco board in {len(corners)} images of {dataset.name}",
    )


def _pixels(seen: dict[int, Array], ids: list[int]) -> Array:
    return np.array([seen[i] for i in ids], np.float32)


def _rig_poses(
    dataset: Dataset, places: Array, corners: BoardCorners, lenses: dict[str, tuple[Array, Array]]
) -> dict[str, tuple[Array, Array]]:
    """`cam_from_rig`: the first camera is the rig; each other is joined to the one it shares most with."""
    shared: dict[frozenset[str], list[tuple[int, list[int]]]] = {}
    for a, b in combinations(dataset.cameras, 2):
        for k in range(len(dataset.instants_ns)):
            ids = sorted(corners.get((a, k), {}).keys() & corners.get((b, k), {}).keys())
            if len(ids) >= MIN_CORNERS:
                shared.setdefault(frozenset((a, b)), []).append((k, ids))
    first = dataset.cameras[0]
    poses = {first: (np.eye(3), np.zeros(3))}
    while len(poses) < len(dataset.cameras):
        left = [b for b in dataset.cameras if b not in poses]
        links = [(len(shared.get(frozenset((a, b)), ())), a, b) for a in poses for b in left]
        count, a, b = max(links, key=lambda link: link[0])
        if count < MIN_BOARDS:
            raise BadInputError(
                f"{b} and {a} show the board together at {count} instants; {MIN_BOARDS} are needed",
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
