"""How one view's surface comes of costs: sources together, smoothing, planes, and where edges are."""

import cv2
import numpy as np
import pytest

from reconstruction.common.geometry import Array
from reconstruction.depth.calibrated_image import CalibratedImage, SourceView
from reconstruction.depth.plane_sweep import move_edges
from reconstruction.depth.sweep_kernels import fit_planes
from tests.unit.reconstruction.depth.array_sweep import aggregate_costs, cheapest_depths, combine_likeness
from tests.unit.reconstruction.depth.small_views import FOCAL, HEIGHT, PAINT, WIDTH, photo_of, view_at


def test_of_two_sources_one_that_sees_something_in_front_spoils_little() -> None:
    def together(*likeness: float) -> float:
        return float(combine_likeness([np.full((2, 2), value, np.float32) for value in likeness])[0, 0])

    same, other = 0.9, 0.1
    assert together(same) == pytest.approx(0.9)
    assert together(same, other) == together(other, same) == pytest.approx(0.62)
    assert together(other, same, same) == pytest.approx(0.9)
    assert together(same, same, other, same) == pytest.approx(0.9)
    assert together(0.1, 0.9, 0.6, 0.8) == pytest.approx(2.3 / 3)


def test_an_edge_moves_to_where_the_pictures_match() -> None:
    reference, source = view_at(0.0), view_at(0.2)
    ys, xs = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    back, front = 0.3, 0.6

    def pixels(x: Array, shift: float) -> Array:
        return np.asarray(cv2.remap(PAINT, 2 * x + 40 + shift, 2 * ys + 40, cv2.INTER_LINEAR))

    def picture(moved: float) -> Array:
        """A strip before a wall, seen from `moved` m to the right."""
        wall, strip = (xs + FOCAL * moved * near for near in (back, front))
        return np.where((strip > 40) & (strip < 80), pixels(strip, 150), pixels(wall, 0))

    grey = [CalibratedImage(view, picture(x), 5, 4.0) for view, x in ((reference, 0.0), (source, 0.2))]
    flat = np.zeros_like(xs)
    true = np.where((xs > 40) & (xs < 80), front, back).astype(np.float32)
    # The strip begins and ends 4 px too far left, as where a matcher took the wall for it.
    wrong = np.roll(true, -4, axis=1)
    level, _, _ = move_edges(np.stack([wrong, flat, flat]), [SourceView(*grey)], 4)
    # Beside the strip's left edge the other view sees no wall, and nothing tells.
    inner = np.s_[8:-8, 60:100]
    assert np.mean(level[inner] != true[inner]) < 0.4 * np.mean(wrong[inner] != true[inner])


def test_semiglobal_fills_a_blank_patch_and_keeps_an_edge() -> None:
    truth = np.full((24, 40), 3)
    truth[:, 20:] = 9
    costs = np.full((24, 12, 40), 200, np.uint8)
    np.put_along_axis(costs, truth[:, None, :], 10, 1)
    costs[8:16, :, 5:12] = 100
    grey = np.where(truth == 3, 50, 200).astype(np.float32)
    place, own = cheapest_depths(aggregate_costs(costs, grey, 20, 300), costs)
    assert np.array_equal(np.rint(place), truth)
    assert own[0, 0] == 10
    assert own[10, 8] == 100


def test_parabola_finds_the_place_between_two_depths() -> None:
    levels = np.arange(8)
    total = ((levels - 3.3) ** 2 * 100).astype(np.int16)[None, :, None]
    place, _ = cheapest_depths(total, total.astype(np.uint8))
    assert place[0, 0] == pytest.approx(3.3, abs=0.02)


def test_planes_are_fitted_on_each_side_of_an_edge() -> None:
    ys, xs = np.mgrid[0:40, 0:60].astype(np.float32)
    truth = np.where(xs < 30, 0.3 + 0.001 * xs - 0.0004 * ys, 0.6 - 0.0005 * xs).astype(np.float32)
    noisy = truth + np.random.default_rng(0).normal(0, 0.002, truth.shape).astype(np.float32)
    level, right, down = fit_planes(noisy, 0.02, radius=2, stride=2, rounds=3)
    assert np.abs(level - truth).mean() < 0.4 * np.abs(noisy - truth).mean()
    assert np.median(right[:, :25]) == pytest.approx(0.001, abs=2e-4)
    assert np.median(down[:, :25]) == pytest.approx(-0.0004, abs=2e-4)
    assert np.median(right[:, 35:]) == pytest.approx(-0.0005, abs=2e-4)


def test_normal_of_a_wall_that_faces_the_camera() -> None:
    photo = photo_of(view_at(0))[0]
    flat = np.full(photo.grey.shape, 0.5, np.float32)
    zero = np.zeros_like(flat)
    assert photo.surface_normals(flat, zero, zero)[5, 7] == pytest.approx([0, 0, -1])
