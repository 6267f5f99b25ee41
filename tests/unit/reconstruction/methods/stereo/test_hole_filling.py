"""Holes of a disparity map are what lies behind: the farther side of each, continued."""

import numpy as np
import pytest

from reconstruction.common.geometry import Array
from reconstruction.methods.stereo.stereo_pair import fill_holes
from tests.unit.reconstruction.conftest import Scene, make_view
from tests.unit.reconstruction.methods.stereo.pairs import synchronized_pair

NAN = float("nan")


def wall_with_a_box(slope: float) -> tuple[Array, Array]:
    """A wall whose disparity grows by `slope` a pixel behind a nearer box; and what both views see of it."""
    wall = np.tile(20 + slope * np.arange(200, dtype=np.float32), (120, 1))
    truth = wall.copy()
    truth[30:90, 100:140] = 60
    seen = truth.copy()
    # Hidden from the other view by the box; and beyond its picture.
    seen[30:90, 70:100] = NAN
    seen[:, :25] = NAN
    return truth, seen


@pytest.mark.parametrize("slope", [0.0, 0.08, -0.08])
def test_a_hole_continues_the_surface_behind(slope: float) -> None:
    truth, seen = wall_with_a_box(slope)
    filled = fill_holes(seen)
    known = np.isfinite(seen)
    assert (filled[known] == seen[known]).all()
    assert np.abs(filled - truth).max() < 0.5


def test_a_row_without_anything_is_as_the_nearest_with_something() -> None:
    seen = np.full((40, 60), NAN, np.float32)
    seen[10, 5:50] = 7.0
    seen[30, 5:50] = 9.0
    filled = fill_holes(seen)
    assert (filled[:18] == 7).all()
    assert (filled[23:] == 9).all()


@pytest.mark.parametrize("shape", [(1, 1), (3, 8), (20, 16)])
def test_where_nothing_is_known_there_is_nothing(shape: tuple[int, int]) -> None:
    assert (fill_holes(np.full(shape, NAN, np.float32)) == 0).all()
    one = np.full(shape, NAN, np.float32)
    one[-1, 0] = 4
    assert (fill_holes(one) == 4).all()


def test_filled_depth_is_the_checked_one_and_right_where_one_view_alone_sees(scene: Scene) -> None:
    pair, image, same, truth = synchronized_pair(scene, make_view((0, 0, 0)), make_view((0.2, 0, 0)))
    found = pair.compute_both(image, same)[1]
    checked = found.depth > 0
    assert (found.filled[checked] == found.depth[checked]).all()
    assert (found.filled > 0).all()
    right = np.abs(found.filled - truth) < 0.02 * truth
    assert right.mean() > 0.96
    assert right[~checked].mean() > 0.8
    assert (found.confidence[~checked] == 0).all()
