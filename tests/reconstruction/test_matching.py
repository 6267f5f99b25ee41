"""The matcher on slanted planes with exact truth, and the pieces that it is made of."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from capture_app.errors import BadInputError
from reconstruction.common.geometry import Array, View, resize_view
from reconstruction.depth.calibrated_image import CalibratedImage, SourceView, combine_costs, mean_of_lowest
from reconstruction.depth.coarse_scene import find_coarse_scene
from reconstruction.depth.edge_moves import move_edges
from reconstruction.depth.geometric_consistency import (
    ConsistencyLimits,
    consistent_and_visible_views,
    consistent_pixels,
    remove_speckles,
)
from reconstruction.depth.plane_fitting import fit_planes, surface_normals
from reconstruction.depth.plane_sweep import Proposals, Surface, SweepOptions, adopt_proposals, sweep_view
from reconstruction.depth.semiglobal_aggregation import aggregate_costs, cheapest_depths
from reconstruction.depth.sweep_matcher import ViewDepth, match_all_views
from tests.reconstruction.conftest import texture
from tests.reconstruction.small_views import FOCAL, HEIGHT, PLACES, WIDTH, choose_by_depth, view_at

PAINT = texture(3).astype(np.float32)
SLOPE = np.array([0.35, -0.5])
Reach = dict[str, tuple[float, float]]


def photo_of(
    view: View, slope: Array = SLOPE, seed: int = 0, gain: float = 1.0
) -> tuple[CalibratedImage, Array]:
    """The plane z = 2 + slope . (x, y), textured, and its depth in the picture."""
    rays = view.rays(view.grid())
    reach = (2 + view.centre[:2] @ slope) / (1 - rays[:, :2] @ slope)
    at = (view.centre[:2] + reach[:, None] * rays[:, :2]) * 150 + 250
    shape = (view.height, view.width)
    xs, ys = (np.mod(at[:, i], 511).astype(np.float32).reshape(shape) for i in (0, 1))
    image = gain * cv2.remap(PAINT, xs, ys, cv2.INTER_LINEAR)
    image += np.random.default_rng(seed).normal(0, 1, shape).astype(np.float32)
    return CalibratedImage(view, np.asarray(image, np.float32), 5, 9.0), reach.reshape(shape)


@pytest.fixture(scope="module")
def photos() -> dict[str, CalibratedImage]:
    return {name: photo_of(view_at(*at), seed=i)[0] for i, (name, at) in enumerate(PLACES.items())}


@pytest.fixture(scope="module")
def truth() -> Array:
    """The depth in the middle picture."""
    return photo_of(view_at(*PLACES["middle"]))[1]


def sources_of(photos: dict[str, CalibratedImage]) -> dict[str, tuple[str, ...]]:
    return choose_by_depth({name: photo.view for name, photo in photos.items()})


def between(photos: dict[str, CalibratedImage], nearest: float, farthest: float) -> Reach:
    return dict.fromkeys(photos, (nearest, farthest))


@pytest.fixture(scope="module")
def matched(photos: dict[str, CalibratedImage]) -> dict[str, ViewDepth]:
    return match_all_views(photos, sources_of(photos), find_coarse_scene(photos).reach)


def test_slanted_plane_is_found_to_a_fraction_of_a_percent(
    matched: dict[str, ViewDepth], truth: Array
) -> None:
    found, true = (depth[8:-8, 20:-20] for depth in (matched["middle"].depth, truth))
    error = np.abs(found - true) / true
    assert np.mean(found > 0) > 0.97
    assert np.median(error) < 0.004
    assert np.mean(error < 0.02) > 0.95


def test_normals_face_the_camera_and_stand_on_the_plane(
    photos: dict[str, CalibratedImage], matched: dict[str, ViewDepth]
) -> None:
    view = matched["middle"]
    there = view.depth > 0
    true = np.array([*SLOPE, -1.0]) / np.linalg.norm([*SLOPE, -1.0])
    angle = np.degrees(np.arccos(np.clip(view.normals[there] @ true, -1, 1)))
    assert np.median(angle) < 6
    assert np.all(view.normals[~there] == 0)
    rays = photos["middle"].rays
    assert np.mean((view.normals * rays.transpose(1, 2, 0)).sum(-1)[there] < 0) > 0.999


def test_no_depth_where_views_show_different_things(photos: dict[str, CalibratedImage]) -> None:
    rng = np.random.default_rng(1)
    strangers = {}
    for name, photo in photos.items():
        noise = cv2.GaussianBlur(rng.normal(128, 90, photo.grey.shape).astype(np.float32), (0, 0), 1.2)
        strangers[name] = replace(photo, grey=noise)
    found = match_all_views(strangers, sources_of(photos), between(photos, 1.4, 4.0))
    assert max(np.mean(view.depth > 0) for view in found.values()) < 0.06


def test_blank_views_are_empty_though_their_depths_agree(photos: dict[str, CalibratedImage]) -> None:
    blank = {name: replace(photo, grey=np.full_like(photo.grey, 90.0)) for name, photo in photos.items()}
    sources = sources_of(photos)
    found = match_all_views(blank, sources, between(photos, 1.4, 4.0))
    assert all(not view.depth.any() for view in found.values())
    with pytest.raises(BadInputError, match="nothing in common"):
        find_coarse_scene(blank)


def test_brightness_may_differ_between_cameras(photos: dict[str, CalibratedImage]) -> None:
    dark = dict(photos)
    dark["right"] = photo_of(view_at(*PLACES["right"]), seed=9, gain=0.7)[0]
    found = match_all_views(dark, sources_of(photos), between(photos, 1.4, 4.0))
    assert np.mean(found["middle"].depth[8:-8, 20:-20] > 0) > 0.9


def test_two_views_are_enough_and_the_range_is_found(photos: dict[str, CalibratedImage]) -> None:
    pair = {name: photos[name] for name in ("left", "right")}
    sources = sources_of(pair)
    reach = find_coarse_scene(pair).reach
    nearest, farthest = reach["left"]
    truth = photo_of(view_at(*PLACES["left"]))[1]
    assert nearest < np.percentile(truth, 10) < np.percentile(truth, 80) < farthest
    found = match_all_views(pair, sources, reach)["left"].depth
    there = found > 0
    assert there.mean() > 0.55
    assert np.mean(np.abs(found - truth)[there] < 0.02 * truth[there]) > 0.95


def test_cameras_may_have_pictures_of_different_sizes(
    photos: dict[str, CalibratedImage], truth: Array
) -> None:
    mixed = dict(photos)
    mixed["right"] = photo_of(resize_view(view_at(*PLACES["right"]), 192, 144), seed=5)[0]
    found = match_all_views(mixed, sources_of(mixed), between(mixed, 1.4, 4.0))
    assert found["right"].depth.shape == (144, 192)
    right = np.abs(found["middle"].depth - truth) < 0.02 * truth
    assert np.mean(right[8:-8, 20:-20]) > 0.9


def test_large_pictures_are_swept_small_and_finished_at_full_size(
    photos: dict[str, CalibratedImage], truth: Array
) -> None:
    others = [photos["left"], photos["right"]]
    surface = sweep_view(photos["middle"], others, 1.4, 4.0, SweepOptions(max_cells=90_000))
    assert surface.inverse_depth.shape == truth.shape
    error = np.abs(surface.inverse_depth * truth - 1)[8:-8, 24:-24]
    assert np.median(error) < 0.006


def test_lens_projects_as_the_geometry_says(photos: dict[str, CalibratedImage]) -> None:
    source_view = SourceView(photos["middle"], photos["right"])
    x, y, z = source_view.project(np.full((HEIGHT, WIDTH), 0.5, np.float32))
    # A point at 2 m, seen 0.15 m further right and 0.02 m higher.
    assert x[10, 30] == pytest.approx(30 - 0.15 / 2 * FOCAL, abs=1e-3)
    assert y[10, 30] == pytest.approx(10 + 0.02 / 2 * FOCAL, abs=1e-3)
    assert z[10, 30] == pytest.approx(1.0)
    moved = source_view.pixels_per_inverse_depth(x, y)
    assert moved[10, 30] == pytest.approx(np.hypot(0.15, 0.02) * FOCAL, rel=1e-3)


def test_a_plane_and_the_same_depth_map_look_alike(photos: dict[str, CalibratedImage]) -> None:
    source_view = SourceView(photos["middle"], photos["right"])
    by_plane = source_view.warp_by_plane(0.45)
    by_map = source_view.warp_by_depth(np.full((HEIGHT, WIDTH), 0.45, np.float32))
    assert np.abs(by_plane - by_map)[5:-5, 5:-12].max() < 1.5


def test_resized_view_keeps_the_rays_of_the_corners() -> None:
    view = view_at(0)
    half = resize_view(view, WIDTH // 2, HEIGHT // 2)
    corner = np.array([[-0.5, -0.5]])
    assert half.rays(corner) == pytest.approx(view.rays(corner))
    assert half.rays(np.array([[63.5, 47.5]])) == pytest.approx(view.rays(np.array([[127.5, 95.5]])))


def test_mean_of_best_leaves_out_the_worst() -> None:
    costs = [np.full((1, 1), value, np.float32) for value in (0.9, 0.1, 0.4, 0.2)]
    for best, mean in ((1, 0.1), (2, 0.15), (3, 0.7 / 3)):
        assert mean_of_lowest(costs, best)[0, 0] == pytest.approx(mean)


def test_of_two_sources_one_that_sees_something_in_front_spoils_little() -> None:
    same, other = (np.full((2, 2), value, np.float32) for value in (0.1, 0.9))
    assert combine_costs([same])[0, 0] == pytest.approx(0.1)
    assert combine_costs([same, other])[0, 0] == pytest.approx(0.38)
    assert combine_costs([other, same, same])[0, 0] == pytest.approx(0.1)
    assert combine_costs([same, same, other, same])[0, 0] == pytest.approx(0.1)


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
    level, _, _ = move_edges((wrong, flat, flat), [SourceView(*grey)], 4)
    # Beside the strip's left edge the other view sees no wall, and nothing tells.
    inner = np.s_[8:-8, 60:100]
    assert np.mean(level[inner] != true[inner]) < 0.4 * np.mean(wrong[inner] != true[inner])


def test_proposals_that_nobody_confirmed_must_match_better(
    photos: dict[str, CalibratedImage], truth: Array
) -> None:
    right, flat = (1 / truth).astype(np.float32), np.zeros((HEIGHT, WIDTH), np.float32)
    cost, proposed = np.full_like(flat, 0.1), np.zeros_like(flat)
    spoilt, doubted = np.s_[20:45, 40:90], np.s_[55:80, 40:90]
    found = right.copy()
    found[spoilt], cost[spoilt], proposed[spoilt] = 0.6 * right[spoilt], 0.9, right[spoilt]
    proposed[doubted] = 0.7 * right[doubted]
    adopted = adopt_proposals(
        Surface(found, flat, flat, cost),
        Proposals(proposed, flat > 0),
        photos["middle"],
        [photos["left"], photos["right"]],
        (1.4, 4.0),
        SweepOptions(),
    )
    error = np.abs(adopted.inverse_depth * truth - 1)
    assert np.mean(error[spoilt] < 0.02) > 0.8
    assert np.mean(error[doubted] < 0.02) > 0.9


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
    level, right, down = fit_planes(noisy, 0.02, reach=2, stride=2, rounds=3)
    assert np.abs(level - truth).mean() < 0.4 * np.abs(noisy - truth).mean()
    assert np.median(right[:, :25]) == pytest.approx(0.001, abs=2e-4)
    assert np.median(down[:, :25]) == pytest.approx(-0.0004, abs=2e-4)
    assert np.median(right[:, 35:]) == pytest.approx(-0.0005, abs=2e-4)


def test_normal_of_a_wall_that_faces_the_camera() -> None:
    photo = photo_of(view_at(0))[0]
    flat = np.full(photo.grey.shape, 0.5, np.float32)
    zero = np.zeros_like(flat)
    assert surface_normals(flat, zero, zero, photo.rays)[5, 7] == pytest.approx([0, 0, -1])


def test_one_vote_is_enough_where_nobody_else_can_see_but_not_against_others() -> None:
    flat = np.zeros((HEIGHT, WIDTH), np.float32)

    def surface(*bands: tuple[int, int, float]) -> Surface:
        level = np.full_like(flat, 0.5)
        for top, bottom, value in bands:
            level[top:bottom] = value
        return Surface(level, flat, flat, flat)

    shots = [photo_of(view_at(x), np.zeros(2))[0] for x in (0.0, -0.1, 0.1, 0.2)]
    source_views = [SourceView(shots[0], other) for other in shots[1:]]
    # To two of three views something near hides the rows 20 to 50; from 50 to 80 they see behind the surface.
    others = [surface(), *(surface((20, 50, 0.8), (50, 80, 0.3)) for _ in range(2))]
    votes = zip(source_views, others, strict=True)
    count, able = consistent_and_visible_views(surface(), votes, ConsistencyLimits())
    inner = slice(20, -30)
    assert (count[22:78, inner] == 1).all()
    assert (able[22:48, inner] == 1).all()
    assert (able[52:78, inner] == 3).all()
    kept = consistent_pixels(surface(), count, able, 3, flat > 0, ConsistencyLimits())
    assert kept[:18, inner].all()
    assert kept[20:45, inner].all()
    assert not kept[55:75, inner].any()


def test_a_rim_that_one_view_sees_is_kept_beside_a_background_that_none_sees() -> None:
    level, rim = np.full((60, 100), 0.4, np.float32), slice(50, 60)
    level[:, :60] = 0.8
    flat = np.zeros_like(level)
    count, able = (np.zeros(level.shape, np.uint8) for _ in range(2))
    count[:, :50] = able[:] = 2
    count[:, rim] = able[:, rim] = 1
    seen = Surface(level, flat, flat, flat)
    kept = consistent_pixels(seen, count, able, 3, flat > 0, ConsistencyLimits())
    assert kept[:, :60].all()
    assert not kept[:, 60:].any()
    # A few pixels whose surface nobody else confirms, as of what moves between the pictures.
    count[:, :56] = 0
    assert not consistent_pixels(seen, count, able, 3, flat > 0, ConsistencyLimits()).any()


def test_speckles_go_and_large_islands_stay() -> None:
    good = np.zeros((40, 40), bool)
    good[2:5, 2:5] = good[10:35, 10:35] = True
    kept = remove_speckles(good, np.full((40, 40), 0.4, np.float32), 50)
    assert not kept[3, 3]
    assert kept[20, 20]
    assert not remove_speckles(np.zeros((4, 4), bool), np.ones((4, 4)), 5).any()
