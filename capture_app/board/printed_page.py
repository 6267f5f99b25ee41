"""A board on a page to print at true size."""

import cv2
import numpy as np

from capture_app.board.charuco import DEFAULT_BOARD, CharucoBoard
from capture_app.board.page import Page


class PrintedPage(Page):
    """A board in the middle of a page."""

    def __init__(self, board: CharucoBoard, page: str = "a4") -> None:
        """Raises BadInputError where the board does not fit the page."""
        square, marker = 1000 * board.square_m, 1000 * board.marker_m
        size = board.across * square, board.down * square
        super().__init__(page, size, "a board", smaller="smaller --square-mm")
        self.board = board
        self._add_board(square, marker)
        sizes = f"squares {square:g} mm, markers {marker:g} mm"
        calibrate = " ".join(["reconstruct calibrate SESSION --from charuco", *calibrate_options(board)])
        self.add_foot(
            f"simulshot ChArUco board {board.shape}, {sizes}, dictionary {board.dictionary}",
            f"Print at 100 % (not 'fit to page') and fix it to something flat. {calibrate}",
        )

    def _add_board(self, square: float, marker: float) -> None:
        words = self.board.words_of_markers()
        modules = words.markerSize + 2
        cell = marker / modules
        made = self.board.to_opencv()
        corners = np.asarray(made.getObjPoints(), np.float64)[:, 0, :2] * 1000
        marked = {tuple((corner / square).astype(int).tolist()) for corner in corners}
        for row in range(self.board.down):
            for column in range(self.board.across):
                if (column, row) not in marked:
                    self.black.append((self.left + column * square, self.top + row * square, square, square))
        for number, corner in zip(np.ravel(made.getIds()).tolist(), corners, strict=True):
            x, y = self.left + float(corner[0]), self.top + float(corner[1])
            self.black.append((x, y, marker, marker))
            bits = cv2.aruco.generateImageMarker(words, number, modules, borderBits=1)
            for row, column in np.argwhere(np.asarray(bits) > 0).tolist():
                self.white.append((x + column * cell, y + row * cell, cell, cell))


def calibrate_options(board: CharucoBoard) -> list[str]:
    """The options that tell a command of this board, none for the default one."""
    if board == DEFAULT_BOARD:
        return []
    return [
        f"--board {board.shape}",
        f"--square-mm {1000 * board.square_m:g}",
        f"--marker-mm {1000 * board.marker_m:g}",
        f"--dictionary {board.dictionary}",
    ]
