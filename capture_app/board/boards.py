"""Calibration boards, ChArUco and plain checkerboard: their squares, markers and corners; their options."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import TYPE_CHECKING, Any

import click

from capture_app.common.errors import BadInputError

if TYPE_CHECKING:
    import cv2
    import numpy as np
    from numpy.typing import NDArray

DICTIONARIES = {"ARUCO_ORIGINAL": 1024} | {
    f"{side}X{side}_{words}": words for side in (4, 5, 6, 7) for words in (50, 100, 250, 1000)
}
"""Number of markers in each of OpenCV's dictionaries."""

MIN_CORNERS = 6
"""Minimum number of detected corners for an image to count."""
PLAIN = "none"
"""Value of the dictionary option for a board without markers."""
_SIDE = click.FloatRange(min=0, min_open=True, max=10_000)


@dataclass(frozen=True)
class Squares:
    """Number of squares across and down, and their side length in m."""

    across: int
    down: int
    square_m: float

    def __post_init__(self) -> None:
        """Raise BadInputError for impossible squares."""
        if not 0 < self.square_m < 10:
            raise BadInputError(
                f"squares of {1000 * self.square_m:g} mm",
                hint="give the printed side of a square: --square-mm 34.3",
            )

    @property
    def shape(self) -> str:
        """Squares across x squares down."""
        return f"{self.across}x{self.down}"

    @property
    def corners(self) -> int:
        """Number of inner corners, which are the points that are detected."""
        return (self.across - 1) * (self.down - 1)


@dataclass(frozen=True)
class CharucoBoard(Squares):
    """A ChArUco board: the markers' side length in m, and the name of their dictionary (such as `4X4_50`)."""

    marker_m: float
    dictionary: str

    def __post_init__(self) -> None:
        """Raise BadInputError for an unknown dictionary or an undetectable shape."""
        words = DICTIONARIES.get(self.dictionary.upper())
        if words is None:
            raise BadInputError(
                f"unknown dictionary {self.dictionary!r}", hint="use one of OpenCV's, such as 4X4_50"
            )
        super().__post_init__()
        if not 0 < self.marker_m < self.square_m:
            raise BadInputError(
                "a board's markers must be smaller than its squares",
                hint="give smaller markers, such as --square-mm 30 --marker-mm 22",
            )
        if min(self.across, self.down) < 3 or self.corners < MIN_CORNERS:
            raise BadInputError(
                f"a board of {self.shape} squares has {max(self.corners, 0)} inner corners; "
                f"{MIN_CORNERS} are needed",
                hint="use a larger board, such as --board 7x5",
            )
        if self.markers > words:
            raise BadInputError(
                f"a board of {self.shape} squares has {self.markers} markers; {self.dictionary} has {words}, "
                "so that some would look alike",
                hint="use fewer squares, or a larger dictionary, such as 5X5_250",
            )

    @property
    def markers(self) -> int:
        """Number of markers: one in each white square."""
        return self.across * self.down // 2

    @property
    def places(self) -> "NDArray[np.float32]":
        """Return the positions of the inner corners by number, (n, 3) in m, z = 0; x right, y down."""
        import numpy as np

        return np.asarray(self.to_opencv().getChessboardCorners(), np.float32)

    def to_opencv(self) -> "cv2.aruco.CharucoBoard":
        """Return OpenCV's object for this board."""
        import cv2

        return cv2.aruco.CharucoBoard(
            (self.across, self.down), self.square_m, self.marker_m, self.words_of_markers()
        )

    def words_of_markers(self) -> "cv2.aruco.Dictionary":
        """Return OpenCV's dictionary of the markers."""
        import cv2

        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{self.dictionary.upper()}"))

    def picture(self, square_px: int) -> "NDArray[np.uint8]":
        """Draw the board without a margin, uint8 grey, with squares of `square_px`."""
        import numpy as np

        size = self.across * square_px, self.down * square_px
        return np.asarray(self.to_opencv().generateImage(size, marginSize=0), np.uint8)


DEFAULT_BOARD = CharucoBoard(7, 5, 0.035, 0.026, "4X4_50")
"""Default board for printing and detection; fits A4 and Letter."""


def squares_seen(grey: "NDArray[Any]") -> tuple[int, int] | None:
    """Return the squares of a board without markers in an image (uint8), the longer side first; None without.

    A board that is partly hidden, or beyond the image's edge, seems smaller. Boards below 5x5 are not told
    from other patterns.
    """
    import cv2

    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE
    is_found, _, cells = cv2.findChessboardCornersSBWithMeta(grey, (4, 4), flags)
    return (max(cells.shape) + 1, min(cells.shape) + 1) if is_found else None


class Checkerboard(Squares):
    """A plain checkerboard without markers."""

    def __post_init__(self) -> None:
        """Raise BadInputError for a shape whose corners cannot be numbered."""
        super().__post_init__()
        if min(self.across, self.down) < 4:
            raise BadInputError(
                f"a checkerboard of {self.shape} squares is too small", hint="use a larger one: --board 10x7"
            )
        if self.across == self.down:
            raise BadInputError(
                f"a checkerboard of {self.shape} squares looks the same from all four sides",
                hint="use one with more squares one way, such as 10x7",
            )

    @property
    def is_ambiguous(self) -> bool:
        """Whether the board looks the same after half a turn: opposite corner squares have one colour."""
        return (self.across + self.down) % 2 == 0

    @property
    def places(self) -> "NDArray[np.float32]":
        """Return the positions of the inner corners by number, (n, 3) in m, z = 0; x right, y down."""
        import numpy as np

        rows, columns = np.mgrid[1 : self.down, 1 : self.across]
        flat = np.stack([columns, rows, np.zeros_like(rows)], axis=-1).reshape(-1, 3)
        return (flat * self.square_m).astype(np.float32)

    def picture(self, square_px: int) -> "NDArray[np.uint8]":
        """Draw the board with a white margin of one square, uint8 grey, with squares of `square_px`."""
        import numpy as np

        rows, columns = np.mgrid[: self.down, : self.across]
        squares = np.pad((rows + columns) % 2, 1, constant_values=1).astype(np.uint8)
        return np.kron(squares, np.full((square_px, square_px), 255, np.uint8))

    def detect(self, grey: "NDArray[Any]") -> "dict[int, NDArray[Any]]":
        """Detect all inner corners in an image (uint8); return their px by number, or none.

        Uses OpenCV's sector based detector (Duda and Frese 2018). The first corner is the one beside a dark
        outer square. If that is ambiguous, it is the one that makes the rows run from left to right.
        """
        import cv2
        import numpy as np

        size = (self.across - 1, self.down - 1)
        is_complete, at = cv2.findChessboardCornersSB(grey, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
        if not is_complete or at is None:
            return {}
        grid = np.asarray(at, float).reshape(size[1], size[0], 2)
        along, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
        if along[0] * down[1] - along[1] * down[0] < 0:  # mirrored
            grid = grid[:, ::-1]
        upside_down = (
            (grid[0, -1] - grid[0, 0])[0] < 0
            if self.is_ambiguous
            else _level(grey, grid[:2, :2]) > _level(grey, grid[-2:, -2:])
        )
        return dict(enumerate((grid[::-1, ::-1] if upside_down else grid).reshape(-1, 2)))


def _level(grey: "NDArray[Any]", corners: "NDArray[Any]") -> float:
    """Return the mean grey value of the square between four inner corners (2 rows, 2 columns, x and y).

    Next to a corner of the board, this square touches the outermost square diagonally and has its colour.
    """
    import numpy as np

    middle = corners.mean((0, 1))
    points = middle + 0.5 * (corners.reshape(-1, 2) - middle)
    columns, rows = np.rint(np.vstack([points, middle])).astype(int).T
    height, width = grey.shape
    return float(grey[rows.clip(0, height - 1), columns.clip(0, width - 1)].mean())


def board_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options --board, --square-mm, --marker-mm and --dictionary; the command receives `board`."""

    @click.option(
        "--board",
        type=_parse_shape,
        default=DEFAULT_BOARD.shape,
        metavar="COLUMNSxROWS",
        help="Squares of the board.",
    )
    @click.option(
        "--square-mm",
        type=_SIDE,
        default=1000 * DEFAULT_BOARD.square_m,
        metavar="MM",
        help="Side of a square, as measured on the print.",
    )
    @click.option(
        "--marker-mm",
        type=_SIDE,
        metavar="MM",
        show_default="about three quarters of a square",
        help="Side of a marker.",
    )
    @click.option(
        "--dictionary",
        default=DEFAULT_BOARD.dictionary,
        metavar="NAME",
        help=f"ArUco dictionary of the markers; {PLAIN} for a plain checkerboard.",
    )
    @wraps(command)
    def with_board(
        board: tuple[int, int], square_mm: float, marker_mm: float | None, dictionary: str, **others: Any
    ) -> Any:
        default_mm = round(DEFAULT_BOARD.marker_m / DEFAULT_BOARD.square_m * square_mm, 1)
        marker_m = (default_mm if marker_mm is None else marker_mm) / 1000
        if dictionary.lower() == PLAIN:
            return command(board=Checkerboard(*board, square_mm / 1000), **others)
        return command(board=CharucoBoard(*board, square_mm / 1000, marker_m, dictionary), **others)

    return with_board


def _parse_shape(text: str) -> tuple[int, int]:
    size = re.fullmatch(r"(\d{1,2})x(\d{1,2})", text)
    if size is None:
        raise click.BadParameter(f"{text!r} is not columns x rows of squares, as in 7x5")
    return int(size[1]), int(size[2])
