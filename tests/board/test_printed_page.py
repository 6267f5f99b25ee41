"""The printed board: what is on the page is the very board that is detected, at true size."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from capture_app.board.charuco import DEFAULT_BOARD, CharucoBoard
from capture_app.board.detector import BoardDetector
from capture_app.board.printed_page import PrintedPage, to_pdf, to_svg
from reconstruction import cli

PX_PER_MM = 6.0
NUMBER = r"(-?[\d.]+)"
PAGE_SIZES = {"a4": (297.0, 210.0), "a3": (420.0, 297.0), "letter": (279.4, 215.9)}


def draw(size_mm: tuple[float, float], parts: list[tuple[int, list[tuple[float, ...]]]]) -> NDArray[np.uint8]:
    """A page of grey rectangles (left, top, width, height; mm), four times as fine and made smaller."""
    fine = 4 * PX_PER_MM
    page = np.full((round(size_mm[1] * fine), round(size_mm[0] * fine)), 255, np.uint8)
    for level, rectangles in parts:
        for left, top, width, height in rectangles:
            x, y = round(left * fine), round(top * fine)
            page[y : round((top + height) * fine), x : round((left + width) * fine)] = level
    return np.asarray(cv2.resize(page, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA), np.uint8)


def read_svg(data: bytes) -> tuple[tuple[float, float], NDArray[np.uint8]]:
    """The page's size in mm and its picture."""
    text = data.decode()
    size = re.search(rf'width="{NUMBER}mm" height="{NUMBER}mm" viewBox="0 0 {NUMBER} {NUMBER}"', text)
    assert size is not None
    assert size[1] == size[3]
    assert size[2] == size[4]
    parts = []
    for colour, path in re.findall(r'<path fill="#(\w+)" d="([^"]*)"', text):
        found = re.findall(rf"M{NUMBER} {NUMBER}h{NUMBER}v{NUMBER}h{NUMBER}z", path)
        parts.append((255 * (colour == "fff"), [tuple(map(float, one[:4])) for one in found]))
    mm = float(size[1]), float(size[2])
    return mm, draw(mm, parts)


def read_pdf(data: bytes) -> tuple[tuple[float, float], NDArray[np.uint8]]:
    """As `read_svg`; also that the table of objects points at them."""
    text = data.decode("latin-1")
    for number, start in enumerate(re.findall(r"(\d{10}) 00000 n", text), 1):
        assert text[int(start) :].startswith(f"{number} 0 obj")
    assert text[int(re.findall(r"startxref\n(\d+)", text)[0]) :].startswith("xref")
    stream = re.search(r"/Length (\d+) >>\nstream\n(.*)\nendstream", text, re.DOTALL)
    assert stream is not None
    assert int(stream[1]) == len(stream[2])
    box = re.search(rf"MediaBox \[0 0 {NUMBER} {NUMBER}\]", text)
    assert box is not None
    matrix = re.search(rf"^{NUMBER} 0 0 {NUMBER} 0 {NUMBER} cm", stream[2])
    assert matrix is not None
    points_per_unit = float(matrix[1])
    assert float(matrix[2]) == -points_per_unit
    assert matrix[3] == box[2]
    mm_per_unit = points_per_unit * 25.4 / 72
    parts: list[tuple[int, list[tuple[float, ...]]]] = []
    for line in stream[2].splitlines():
        if fill := re.fullmatch(r"([01]) g", line):
            parts.append((255 * int(fill[1]), []))
        elif box_of := re.fullmatch(rf"{NUMBER} {NUMBER} {NUMBER} {NUMBER} re", line):
            parts[-1][1].append(tuple(float(value) * mm_per_unit for value in box_of.groups()))
    mm = float(box[1]) * 25.4 / 72, float(box[2]) * 25.4 / 72
    return mm, draw(mm, parts)


BOARDS = [
    (DEFAULT_BOARD, "a4"),
    (DEFAULT_BOARD, "letter"),
    (CharucoBoard(7, 5, 0.05, 0.037, "4X4_50"), "a3"),
    (CharucoBoard(5, 8, 0.03, 0.021, "5X5_250"), "a4"),
]


@pytest.mark.parametrize(("board", "page"), BOARDS)
def test_the_board_is_found_on_the_page_at_its_true_size(board: CharucoBoard, page: str) -> None:
    printed = PrintedPage(board, page)
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
