"""What cameras see beyond all surfaces: its own colour, by direction, and only where it is no hole."""

from dataclasses import replace

import numpy as np
import pytest

from reconstruction.depth.backdrop import BEYOND, add_backdrop, find_backdrop
from reconstruction.depth.seen_moment import Moment, SeenView
from reconstruction.depth.view_blending import render
from tests.unit.reconstruction.depth.moments import BOARD_M, moment, seen, view_at

BLUE = (120, 20, 10)


def before_blue(view_seen: SeenView) -> SeenView:
    """What a camera sees of the board before a blue cloth, of which no map has depth."""
    board = view_seen.depth < 1.05 * BOARD_M
    return replace(
        view_seen,
        colours=np.where(board[..., None], view_seen.colours, np.array(BLUE, np.uint8)),
        depth=np.where(board, view_seen.depth, 0).astype(np.float32),
    )


def board_before_blue() -> Moment:
    """The known moment with a blue cloth in the place of its wall."""
    return {camera: before_blue(one) for camera, one in moment().items()}


def test_a_backdrop_has_the_pictures_own_colour_in_all_directions() -> None:
    backdrop = find_backdrop(board_before_blue())
    assert backdrop is not None
    assert np.abs(backdrop.colours.astype(int) - BLUE).max() <= 1
    assert backdrop.centre == pytest.approx([0, 0, BOARD_M], abs=0.1)
    assert backdrop.radius == pytest.approx(BEYOND * np.hypot(BOARD_M, 0.25), rel=0.05)


def test_a_backdrops_colours_are_where_cameras_see_them() -> None:
    cameras = board_before_blue()
    for one in cameras.values():
        one.colours[:45][one.depth[:45] == 0] = (0, 200, 0)
    backdrop = find_backdrop(cameras)
    assert backdrop is not None
    height, width = backdrop.colours.shape[:2]
    # The cameras look at it along z: the middle of the sphere's picture.
    above, below = (backdrop.colours[height // 2 + rows, width // 2 - 3 : width // 2 + 3] for rows in (-9, 9))
    assert above.mean(axis=0) == pytest.approx((0, 200, 0), abs=30)
    assert below.mean(axis=0) == pytest.approx(BLUE, abs=30)


def test_holes_in_surfaces_are_no_backdrop() -> None:
    cameras = moment()
    for one in cameras.values():
        one.depth[30:50, 40:60] = 0
    assert find_backdrop(cameras) is None
    # What another camera's map shows is not beyond all surfaces.
    alone = {**moment(), "left": replace(seen(view_at(-0.25)), depth=np.zeros((90, 120), np.float32))}
    assert find_backdrop(alone) is None


def test_a_view_from_elsewhere_shows_the_backdrop_and_no_smear_of_what_is_before_it() -> None:
    cameras = board_before_blue()
    view = view_at(0.1, -0.1)
    truth = before_blue(seen(view)).colours.astype(int)
    behind = before_blue(seen(view)).depth == 0

    def wrong(moment: Moment) -> float:
        return float(np.abs(render(view, moment).colours.astype(int) - truth)[behind].mean())

    assert wrong(add_backdrop(cameras)) < 2 < 20 < wrong(cameras)
    sphere = add_backdrop(cameras)["left"]
    surface = cameras["left"].depth > 0
    assert np.array_equal(sphere.depth[surface], cameras["left"].depth[surface])
    away = BEYOND * np.hypot(BOARD_M, 0.25)
    assert sphere.depth[5, 60] == pytest.approx(away + BOARD_M, rel=0.1)


def test_a_moment_without_a_backdrop_stays_as_it_is() -> None:
    assert add_backdrop(cameras := moment()) is cameras
