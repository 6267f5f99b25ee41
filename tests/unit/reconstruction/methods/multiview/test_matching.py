"""The matcher on slanted planes with exact truth, and how its views see each other's pictures."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.console.terminal import Progress
from reconstruction.common.geometry import Array, resize_view
from reconstruction.depth.calibrated_image import CalibratedImage, SourceView
from reconstruction.depth.plane_sweep import PlaneSweep, Surface
from reconstruction.depth.rough_scene import find_rough_scene
from reconstruction.depth.sweep_kernels import cost_volume
from reconstruction.methods.multiview import sweep_matcher
from reconstruction.methods.multiview.sweep_matcher import ViewDepth, match_all_views
from tests.unit.reconstruction.depth.array_sweep import pixels_per_inverse_depth
from tests.unit.reconstruction.depth.small_views import (
    FOCAL,
    HEIGHT,
    PLACES,
    SLOPE,
    WIDTH,
    choose_by_depth,
    photo_of,
    view_at,
)

DepthRanges = dict[str, tuple[float, float]]


@pytest.fixture(scope="module")
def photos() -> dict[str, CalibratedImage]:
    return {name: photo_of(view_at(*at), seed=i)[0] for i, (name, at) in enumerate(PLACES.items())}


@pytest.fixture(scope="module")
def truth() -> Array:
    """The depth in the middle picture."""
    return photo_of(view_at(*PLACES["middle"]))[1]


def sources_of(photos: dict[str, CalibratedImage]) -> dict[str, tuple[str, ...]]:
    return choose_by_depth({name: photo.view for name, photo in photos.items()})


def between(photos: dict[str, CalibratedImage], nearest: float, farthest: float) -> DepthRanges:
    return dict.fromkeys(photos, (nearest, farthest))


@pytest.fixture(scope="module")
def matched(photos: dict[str, CalibratedImage]) -> dict[str, ViewDepth]:
    return match_all_views(photos, sources_of(photos), find_rough_scene(photos).depth_ranges)


def test_slanted_plane_is_found_to_a_fraction_of_a_percent(
    matched: dict[str, ViewDepth], truth: Array
) -> None:
    found, true = (depth[8:-8, 20:-20] for depth in (matched["middle"].depth, truth))
    error = np.abs(found - true) / true
    assert np.mean(found > 0) > 0.97
    assert np.median(error) < 0.004
    assert np.mean(error < 0.02) > 0.95


def shows_its_surface(view: ViewDepth) -> bool:
    """Whether all depth is that of the view's own surface, and there is some."""
    assert view.surface is not None
    there = view.depth > 0
    return bool(there.any()) and np.allclose(
        view.depth[there] * view.surface.inverse_depth[there], 1, rtol=1e-4
    )


def test_depth_is_the_last_surfaces_where_others_confirm_it(
    photos: dict[str, CalibratedImage], matched: dict[str, ViewDepth], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert all(shows_its_surface(view) for view in matched.values())
    texts: list[str] = []
    progress = Progress(9, silent=True)
    monkeypatch.setattr(progress, "step", texts.append)
    pair = {name: photos[name] for name in ("left", "right")}
    both = {"left": ["right"], "right": ["left"]}
    found = match_all_views(pair, both, between(pair, 1.4, 4.0), progress)
    assert sorted(texts) == ["depth of left", "depth of right"]
    assert all(shows_its_surface(view) for view in found.values())


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
    with pytest.raises(BadInputError, match="no matching points"):
        find_rough_scene(blank)


def test_planes_that_are_laid_are_sharpened(
    photos: dict[str, CalibratedImage], monkeypatch: pytest.MonkeyPatch
) -> None:
    pair = {name: photos[name] for name in ("left", "right")}
    laid = {name: Surface(*np.ones((4, *photo.grey.shape), np.float32)) for name, photo in pair.items()}
    given = list[Surface]()

    def sharpen(surface: Surface, *_: object) -> Surface:
        given.append(surface)
        raise BadInputError("that is enough")

    monkeypatch.setattr(sweep_matcher, "fit_blank_walls", lambda *_: (laid, None))
    monkeypatch.setattr(sweep_matcher, "sharpen_edges", sharpen)
    monkeypatch.setattr(PlaneSweep, "sweep", lambda _, image, *of: Surface(*np.zeros((4, *image.grey.shape))))
    with pytest.raises(BadInputError, match="that is enough"):
        match_all_views(pair, sources_of(pair), between(pair, 1.4, 4.0))
    assert given
    assert all((part == 1).all() for surface in given for part in surface)


def test_brightness_may_differ_between_cameras(photos: dict[str, CalibratedImage]) -> None:
    dark = dict(photos)
    dark["right"] = photo_of(view_at(*PLACES["right"]), seed=9, gain=0.7)[0]
    found = match_all_views(dark, sources_of(photos), between(photos, 1.4, 4.0))
    assert np.mean(found["middle"].depth[8:-8, 20:-20] > 0) > 0.9


def test_two_views_are_enough_and_the_range_is_found(photos: dict[str, CalibratedImage]) -> None:
    pair = {name: photos[name] for name in ("left", "right")}
    sources = sources_of(pair)
    depth_ranges = find_rough_scene(pair).depth_ranges
    nearest, farthest = depth_ranges["left"]
    truth = photo_of(view_at(*PLACES["left"]))[1]
    assert nearest < np.percentile(truth, 10) < np.percentile(truth, 80) < farthest
    found = match_all_views(pair, sources, depth_ranges)["left"].depth
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
    surface = PlaneSweep(max_cells=90_000).sweep(photos["middle"], others, (1.4, 4.0))
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
    moved = pixels_per_inverse_depth(source_view, x, y)
    assert moved[10, 30] == pytest.approx(np.hypot(0.15, 0.02) * FOCAL, rel=1e-3)


def test_a_plane_and_the_same_depth_map_look_alike(photos: dict[str, CalibratedImage]) -> None:
    source_view = SourceView(photos["middle"], photos["right"])
    by_plane = cost_volume([source_view], None, np.array([0.45])).copy()
    by_map = cost_volume([source_view], np.full((HEIGHT, WIDTH), 0.45, np.float32), np.zeros(1))
    assert np.abs(by_plane.astype(int) - by_map).max() < 5


def test_resized_view_keeps_the_rays_of_the_corners() -> None:
    view = view_at(0)
    half = resize_view(view, WIDTH // 2, HEIGHT // 2)
    corner = np.array([[-0.5, -0.5]])
    assert half.rays(corner) == pytest.approx(view.rays(corner))
    assert half.rays(np.array([[63.5, 47.5]])) == pytest.approx(view.rays(np.array([[127.5, 95.5]])))


def test_proposals_that_nobody_confirmed_must_match_better(
    photos: dict[str, CalibratedImage], truth: Array
) -> None:
    right, flat = (1 / truth).astype(np.float32), np.zeros((HEIGHT, WIDTH), np.float32)
    cost, proposed = np.full_like(flat, 0.1), np.zeros_like(flat)
    spoilt, doubted = np.s_[20:45, 40:90], np.s_[55:80, 40:90]
    found = right.copy()
    found[spoilt], cost[spoilt], proposed[spoilt] = 0.6 * right[spoilt], 0.9, right[spoilt]
    proposed[doubted] = 0.7 * right[doubted]
    adopted = PlaneSweep().adopt_proposals(
        Surface(found, flat, flat, cost),
        proposed,
        flat > 0,
        photos["middle"],
        [photos["left"], photos["right"]],
        (1.4, 4.0),
    )
    error = np.abs(adopted.inverse_depth * truth - 1)
    assert np.mean(error[spoilt] < 0.02) > 0.8
    assert np.mean(error[doubted] < 0.02) > 0.9
