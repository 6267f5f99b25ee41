"""Makes the pictures of docs/calibration.md: the printed page, how to hold the board, and what is counted.

`make pictures NAME=calibration`; a minute on two free cores. The pictures are those of the simulated scene
`board`, with what is really found in them; the table is what `capture-app coverage` draws.
"""

import io
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from capture_app.board.boards import DEFAULT_BOARD
from capture_app.board.coverage import BoardCoverage, CoverageCount, coverage_table
from capture_app.board.detector import BoardDetector, Corners
from capture_app.board.printing import board_page, to_svg
from capture_app.plugins.cameras.sim.rendering.scene import load

OUT = Path(__file__).parent
CAMERAS = ("cam00", "cam01", "cam04", "cam05")
EVERY_S = 1.3
MOMENTS = 16
SHOWN, SHOWN_CORNERS = 6, 15
"""So many of the first camera's pictures are shown, with so many corners at least."""
EXPOSURE_NS, ROW_NS = 4_000_000, 11_000
TILE_PX = 300


def main() -> None:
    """Write all pictures."""
    (OUT / "calibration-board.svg").write_bytes(to_svg(board_page(DEFAULT_BOARD)))
    scene = load("board").draft(1.0)
    detector = BoardDetector(DEFAULT_BOARD)
    count = CoverageCount(DEFAULT_BOARD, dict.fromkeys(CAMERAS, (640, 480)))
    tiles, corners = [], []
    for moment in range(MOMENTS):
        seen: dict[str, Corners] = {}
        for name in CAMERAS:
            shot = scene.render(name, round(moment * EVERY_S * 1e9), EXPOSURE_NS, ROW_NS, seed=moment)
            seen[name] = detector.detect(cv2.cvtColor(shot, cv2.COLOR_BGR2GRAY))
            if name == CAMERAS[0]:
                corners += list(seen[name].values())
                if len(seen[name]) >= SHOWN_CORNERS and len(tiles) < SHOWN:
                    tiles.append(with_corners(shot, seen[name]))
                if moment == MOMENTS - 1:
                    last = shot
        count.add({name: found for name, found in seen.items() if found})
        if moment == MOMENTS // 2:
            early = count.coverage()
    rows = [np.hstack(tiles[:3]), np.hstack(tiles[3:])]
    save_jpeg("calibration-hold.jpg", np.vstack(rows))
    save_jpeg("calibration-covered.jpg", covered(last, corners))
    save_table("calibration-coverage.svg", early)


def with_corners(shot: NDArray[np.uint8], found: Corners) -> NDArray[np.uint8]:
    """A small picture, with the corners that were found in it."""
    drawn = shot.copy()
    for x, y in found.values():
        cv2.circle(drawn, (round(float(x)), round(float(y))), 6, (60, 220, 60), -1, cv2.LINE_AA)
    return small(drawn)


def covered(shot: NDArray[np.uint8], corners: list[NDArray[np.float64]]) -> NDArray[np.uint8]:
    """All corners of all moments, over a pale picture."""
    drawn = np.asarray(255 - (255 - shot) // 3, np.uint8)
    for x, y in corners:
        cv2.circle(drawn, (round(float(x)), round(float(y))), 4, (30, 150, 30), -1, cv2.LINE_AA)
    for third in (1, 2):
        cv2.line(drawn, (640 * third // 3, 0), (640 * third // 3, 480), (120, 120, 120), 1)
        cv2.line(drawn, (0, 480 * third // 3), (640, 480 * third // 3), (120, 120, 120), 1)
    return small(drawn)


def small(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The picture as wide as a tile."""
    size = TILE_PX, TILE_PX * picture.shape[0] // picture.shape[1]
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def save_jpeg(name: str, picture: NDArray[np.uint8]) -> None:
    """Write it beside this file."""
    cv2.imwrite(str(OUT / name), picture, [cv2.IMWRITE_JPEG_QUALITY, 80])


def save_table(name: str, found: BoardCoverage) -> None:
    """What the command draws in a terminal, as SVG."""
    console = Console(record=True, width=84, file=io.StringIO())
    head, rows = coverage_table(found)
    table = Table(*head)
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    console.print(Group(table, *(Text(line) for line in found.missing[:4])))
    console.save_svg(str(OUT / name), title="capture-app coverage")


if __name__ == "__main__":
    main()
