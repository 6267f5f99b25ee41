"""What the board has covered, and the advice that follows."""

from itertools import product

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from capture_app.board.boards import DEFAULT_BOARD
from capture_app.board.coverage import MOMENT_NS, CoverageCount, PreviewCount, coverage_table
from capture_app.board.detector import Corners

WIDTH, HEIGHT, FOCAL = 640, 480, 600.0
SIZES = {"a": (WIDTH, HEIGHT), "b": (WIDTH, HEIGHT)}
LENS = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1.0]])


def held(right: float, down: float, *, across: float = 0.0, along: float = 0.0) -> Corners:
    """Corners of the board held aside of the axis at 0.7 m (shares of the picture), turned by degrees."""
    turn = cv2.Rodrigues(np.radians([along, across, 0.0]))[0]
    middle = DEFAULT_BOARD.places.mean(0)
    at = np.array([right * WIDTH, down * HEIGHT, FOCAL]) * 0.7 / FOCAL
    points = (DEFAULT_BOARD.places - middle) @ turn.T + at
    pixels = cv2.projectPoints(points, np.zeros(3), np.zeros(3), LENS, np.zeros(5))[0].reshape(-1, 2)
    inside = (pixels > 0).all(1) & (pixels < (WIDTH, HEIGHT)).all(1)
    return {int(number): pixels[number] for number in np.flatnonzero(inside)}


SWEEP = [
    held(right, down, across=across, along=along)
    for (right, down), (across, along) in zip(
        product((-0.33, 0.0, 0.33), (-0.3, 0.0, 0.3)),
        [(0, 0), (25, 0), (0, 25), (-25, 0), (0, -25), (25, 25), (0, 0), (30, 0), (0, 30)],
        strict=True,
    )
]


def test_a_board_that_is_held_still_counts_once_and_is_sent_on() -> None:
    count = CoverageCount(DEFAULT_BOARD, SIZES)
    for _ in range(30):
        count.add({"a": held(0.3, 0.3), "b": held(0.3, 0.3)})
    found = count.coverage()
    assert found.cameras["a"].views == 1
    assert found.shared[0].views == 1
    assert "upper left" in found.cameras["a"].empty
    assert "lower right" not in found.cameras["a"].empty
    assert found.cameras["a"].covered < 0.4
    assert found.missing[0] == "hold the board where a and b both see it (1 of 6 views)"
    assert "move the board to the upper left and the top of a" in found.missing
    assert "tilt the board more to the left and right for b" in found.missing
    assert "tilt the board more up and down for b" in found.missing
    assert "9 more different views for b" in found.missing


def test_a_board_that_was_everywhere_is_enough() -> None:
    count = CoverageCount(DEFAULT_BOARD, SIZES)
    for number, corners in enumerate(SWEEP):
        assert not count.coverage().enough, f"enough after {number} views"
        count.add({"a": corners, "b": corners})
    count.add({"a": held(0.1, 0.1), "b": held(0.1, 0.1)})
    found = count.coverage()
    assert found.missing == ()
    assert found.cameras["a"].views == 10
    assert found.cameras["a"].covered >= 0.6
    assert found.shared[0].views == 10
    head, rows = coverage_table(found)
    assert len(head) == len(rows[0])
    assert rows[0][0] == "a"
    assert rows[0][-1] == "b 10"


def test_tilts_are_told_apart() -> None:
    count = CoverageCount(DEFAULT_BOARD, {"a": (WIDTH, HEIGHT)})
    for angle in (20, -20, 30):
        count.add({"a": held(0, 0, across=angle)})
    found = count.coverage().cameras["a"]
    assert (found.tilted_across, found.tilted_along) == (3, 0)
    count.add({"a": held(0, 0, along=25)})
    assert count.coverage().cameras["a"].tilted_along == 1


def test_cameras_that_never_see_it_together_are_to_be_joined() -> None:
    count = CoverageCount(DEFAULT_BOARD, dict.fromkeys("abc", (WIDTH, HEIGHT)))
    for corners in SWEEP:
        count.add({"a": corners, "b": corners})
        count.add({"c": corners})
    joins = [line for line in count.coverage().missing if line.startswith("hold the board where")]
    assert joins == ["hold the board where a and c both see it (0 of 6 views)"]


def test_a_camera_that_has_not_seen_it_is_named_first() -> None:
    count = CoverageCount(DEFAULT_BOARD, {"a": (WIDTH, HEIGHT)})
    assert count.coverage().missing[0].startswith("a has not seen the board yet")


@pytest.fixture(scope="module")
def preview() -> NDArray[np.uint8]:
    """The board in a preview of a third of the size."""
    large = np.full((3 * HEIGHT, 3 * WIDTH), 180, np.uint8)
    board = DEFAULT_BOARD.picture(120)
    large[300 : 300 + board.shape[0], 500 : 500 + board.shape[1]] = board
    small = cv2.resize(large, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    coded = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 75])[1]
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)


def test_previews_of_one_moment_are_shared_whatever_their_size(preview: NDArray[np.uint8]) -> None:
    sizes = dict.fromkeys("ab", (3 * WIDTH, 3 * HEIGHT))
    count = PreviewCount(DEFAULT_BOARD, sizes)
    count.add("a", 0, preview)
    found = count.add("b", MOMENT_NS - 1, preview)
    assert [camera.views for camera in found.cameras.values()] == [1, 1]
    assert [pair.views for pair in found.shared] == [1]
    assert "upper left" in found.cameras["a"].empty
    assert "middle" not in found.cameras["a"].empty

    apart = PreviewCount(DEFAULT_BOARD, sizes)
    apart.add("a", 0, preview)
    assert apart.add("b", MOMENT_NS + 1, preview).shared == ()
    # A clock that is not known yet, and what is no picture.
    assert apart.add("a", None, preview).cameras["a"].views == 1
    assert apart.add("a", 5 * MOMENT_NS, None).cameras["a"].views == 1
