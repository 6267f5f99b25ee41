"""Detects a board in pictures: one with markers printed light or dark, from its front or its back."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.board.boards import MIN_CORNERS, CharucoBoard, Checkerboard

Board = CharucoBoard | Checkerboard
Corners = dict[int, NDArray[Any]]
"""Pixels (2,) of the board's corners by their number."""


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

    def __init__(self, board: Board) -> None:
        self._plain = board if isinstance(board, Checkerboard) else None
        self._detector = (
            cv2.aruco.CharucoDetector(board.to_opencv()) if isinstance(board, CharucoBoard) else None
        )
        self._places = np.asarray(board.places, np.float64)[:, :2]
        self._appearances = [BoardAppearance(dark, back) for dark in (False, True) for back in (False, True)]

    def detect(self, grey: NDArray[Any]) -> Corners:
        """Pixels of the board's corners by their number in a picture (uint8); none = it is not there."""
        if self._plain is not None:
            found = self._plain.detect(grey)
            flat = found and is_flat_board(self._places, np.array(list(found.values())))
            return found if flat else {}
        for appearance in self._appearances:
            found = self._detect_as(appearance, grey)
            if found:
                self._appearances.remove(appearance)
                self._appearances.insert(0, appearance)
                return found
        return {}

    def _detect_as(self, appearance: BoardAppearance, grey: NDArray[Any]) -> Corners:
        seen = 255 - grey if appearance.dark else grey
        if appearance.back:
            seen = np.ascontiguousarray(seen[:, ::-1])
        if self._detector is None:
            return {}
        at, numbers, _, _ = self._detector.detectBoard(seen)
        if numbers is None or len(numbers) < MIN_CORNERS:
            return {}
        ids, pixels = np.ravel(numbers), np.asarray(at, float).reshape(-1, 2)
        if not is_flat_board(self._places[ids], pixels):
            return {}
        if appearance.back:
            pixels[:, 0] = grey.shape[1] - 1 - pixels[:, 0]
        return dict(zip(ids.tolist(), pixels, strict=True))


MAX_BEND_SHARE = 0.03
"""Corners further from a flat board than this share of its size were misread; a lens bends it less."""


def is_flat_board(places: NDArray[Any], pixels: NDArray[Any]) -> bool:
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
