"""Board detection in images; a board with markers may be printed light or dark, and seen from either side."""

from collections.abc import Callable
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.board.boards import MIN_CORNERS, CharucoBoard, Checkerboard

Board = CharucoBoard | Checkerboard
Corners = dict[int, NDArray[Any]]
"""Positions (2,) in px of the board's corners, by number."""
MAX_BEND_FRACTION = 0.03
"""Maximum deviation of a corner from a flat board, relative to its size; more is a misdetection.

A lens bends the board less than that.
"""


class BoardDetector:
    """Detector of a board; for one with markers it first tries the appearance that it had last time.

    The board may be dark, printed white on black. It may be seen from the back, if printed on both sides or
    on glass, as cameras on two sides of it require.
    """

    def __init__(self, board: Board) -> None:
        self._places = np.asarray(board.places, np.float64)[:, :2]
        self._find: Callable[[NDArray[Any]], Corners]
        if isinstance(board, Checkerboard):
            self._find, self._appearances = board.detect, [(False, False)]
        else:
            self._find = partial(_find_marked, cv2.aruco.CharucoDetector(board.to_opencv()))
            self._appearances = [(dark, back) for dark in (False, True) for back in (False, True)]

    def detect(self, grey: NDArray[Any]) -> Corners:
        """Detect the board's corners in an image (uint8); return their px by number, none without a board."""
        for dark, back in self._appearances:
            seen = 255 - grey if dark else grey
            detection = self._find(np.ascontiguousarray(seen[:, ::-1]) if back else seen)
            if detection and is_flat_board(self._places[[*detection]], np.array([*detection.values()])):
                self._appearances.sort(key=lambda appearance: appearance != (dark, back))
                mirrored = {n: np.array([grey.shape[1] - 1 - x, y]) for n, (x, y) in detection.items()}
                return mirrored if back else detection
        return {}


def _find_marked(detector: cv2.aruco.CharucoDetector, grey: NDArray[Any]) -> Corners:
    at, numbers, _, _ = detector.detectBoard(grey)
    if numbers is None or len(numbers) < MIN_CORNERS:
        return {}
    return dict(zip(np.ravel(numbers).tolist(), np.asarray(at, float).reshape(-1, 2), strict=True))


def is_flat_board(places: NDArray[Any], pixels: NDArray[Any]) -> bool:
    """Return whether pixels (n, 2) match corners at `places` (n, 2; m) of a flat board, not mirrored."""
    if np.linalg.matrix_rank(places - places.mean(0)) < 2:
        return False
    matrix, _ = cv2.findHomography(places, pixels)
    if matrix is None:
        return False
    seen = np.column_stack([places, np.ones(len(places))]) @ matrix.T
    # The board's x and y point right and down, as the image's do: otherwise it was read mirrored.
    if (np.linalg.det(matrix) * seen[:, 2]).min() <= 0:
        return False
    error = np.linalg.norm(seen[:, :2] / seen[:, 2:] - pixels, axis=1)
    return bool(error.max() < MAX_BEND_FRACTION * np.linalg.norm(np.ptp(pixels, axis=0)) + 1)
