"""The printed board: what is on the page is the very board that is detected, at true size."""

from pathlib import Path

import numpy as np
import pytest

from capture_app.board.boards import DEFAULT_BOARD, CharucoBoard
from capture_app.board.detector import BoardDetector
from capture_app.board.printing import board_page, to_pdf, to_svg
from reconstruction import cli
from tests.unit.board.pages import PX_PER_MM, read_pdf, read_svg

PAGE_SIZES = {"a4": (297.0, 210.0), "a3": (420.0, 297.0), "letter": (279.4, 215.9)}
BOARDS = [
    (DEFAULT_BOARD, "a4"),
    (DEFAULT_BOARD, "letter"),
    (CharucoBoard(7, 5, 0.05, 0.037, "4X4_50"), "a3"),
    (CharucoBoard(5, 8, 0.03, 0.021, "5X5_250"), "a4"),
]


@pytest.mark.parametrize(("board", "page"), BOARDS)
def test_the_board_is_found_on_the_page_at_its_true_size(board: CharucoBoard, page: str) -> None:
    printed = board_page(board, page)
    for size, picture in (read_svg(to_svg(printed)), read_pdf(to_pdf(printed))):
        assert sorted(size) == pytest.approx(sorted(PAGE_SIZES[page]), abs=0.01)
        found = BoardDetector(board).detect(picture)
        assert len(found) == board.corners
        at = np.array([found[number] for number in sorted(found)]) / PX_PER_MM
        places = 1000 * board.places[:, :2]
        # Millimetres on the paper, from the first corner on; a twelfth of a pixel of the picture is 14 µm.
        error = (at - at[0]) - (places - places[0])
        assert np.abs(error).max() < 0.05
        left = at[0, 0] - places[0, 0]
        right = size[0] - left - 1000 * board.across * board.square_m
        assert left == pytest.approx(right, abs=0.2)


def test_the_bar_is_a_hundred_millimetres(tmp_path: Path) -> None:
    file = tmp_path / "board.svg"
    assert cli.run(["board", str(file)]) == 0
    _, picture = read_svg(file.read_bytes())
    dark = picture < 128
    # The board is the tallest thing; the bar is the lowest.
    row = np.flatnonzero(dark.any(axis=1))[-2]
    columns = np.flatnonzero(dark[row])
    assert (columns[-1] - columns[0] + 1) / PX_PER_MM == pytest.approx(100, abs=0.2)
    assert "7x5, squares 35 mm, markers 26 mm, dictionary 4X4_50" in file.read_text()


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["--board", "3x3"], "has 4 inner corners; 6 are needed"),
        (["--board", "12x12"], "has 72 markers; 4X4_50 has 50"),
        (["--square-mm", "50"], "350 x 250 mm does not fit A4"),
        (["--square-mm", "30", "--marker-mm", "30"], "markers must be smaller than its squares"),
        (["--square-mm", "nan"], "squares of nan mm"),
        (["--dictionary", "5X5"], "unknown dictionary '5X5'"),
        (["--board", "7by5"], "not columns x rows"),
    ],
)
def test_boards_that_cannot_be_are_refused(
    arguments: list[str], problem: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "board.pdf"
    assert cli.run(["board", str(file), *arguments]) in (2, 3)
    (line,) = capsys.readouterr().err.splitlines()
    assert problem in line
    assert not file.exists()


def test_other_formats_and_places_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["board", str(tmp_path / "board.png")]) == 2
    assert cli.run(["board", str(tmp_path / "nowhere" / "board.pdf")]) == 1
    assert "cannot write" in capsys.readouterr().err
