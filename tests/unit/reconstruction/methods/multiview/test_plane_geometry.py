"""Depth's formulas against planes whose depth is known in closed form.

The cameras are turned, stand apart in all three directions, and have principal points off the middle and
focal lengths that differ in x and y: a wrong sign anywhere gives another number.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from types import ModuleType

import cv2
import numpy as np
import pytest

from reconstruction.common.geometry import Array, View
from reconstruction.depth import sweep_kernels
from reconstruction.depth.calibrated_image import OUTSIDE, CalibratedImage, SourceView
from reconstruction.depth.plane_sweep import (
    MIN_PLANES,
    STEP_PX,
    PlaneSweep,
    Surface,
    enlarge_surface,
    motion_px,
    move_edges,
)
from reconstruction.depth.rough_scene import find_rough_scene
from reconstruction.depth.sweep_kernels import Agreement
from reconstruction.depth.view_choice import (
    BEST_ANGLES_DEG,
    MAX_ANGLE_DEG,
    angle_fitness,
    choose_source_views,
    find_overlaps,
    seen_points,
)
from reconstruction.methods.multiview import blank_walls, mesh
from reconstruction.methods.multiview.blank_walls import (
    AS_FOUND,
    BlankPart,
    ScenePlane,
    choose_planes,
    extract_blank_part,
    fit_blank_walls,
    lay_planes,
    sample_surface,
)
from reconstruction.methods.multiview.fusion import project_points
from reconstruction.methods.multiview.instant_scoring import (
    TOLERANCE_M,
    VISIBLE_FRACTION,
    count_near,
    visible_points,
)
from reconstruction.methods.multiview.mesh import draw_clouds, up_direction
from reconstruction.methods.multiview.sweep_matcher import propose_inverse_depth
from tests.unit.reconstruction.depth import array_sweep
from tests.unit.reconstruction.depth.array_sweep import (
    cosine_of_rays,
    pixels_per_inverse_depth,
    sweep_by_arrays,
)

BOTH = pytest.mark.parametrize("steps", [array_sweep, sweep_kernels], ids=["arrays", "compiled"])
"""A test that both versions of the sweep's steps pass."""


def turned_view(
    angles_deg: tuple[float, float, float], centre: tuple[float, float, float], **size: float
) -> View:
    """A camera at `centre` in the rig, turned about x, y and z, its axis off the picture's middle."""
    rotation, _ = cv2.Rodrigues(np.radians(angles_deg))
    given = {"width": 80, "height": 60, "fx": 75.0, "fy": 70.0, "cx": 31.0, "cy": 36.0} | size
    matrix = np.array([[given["fx"], 0, given["cx"]], [0, given["fy"], given["cy"]], [0, 0, 1]])
    centre_ = np.array(centre)
    return View(int(given["width"]), int(given["height"]), matrix, np.zeros(5), rotation, -rotation @ centre_)


REFERENCE = turned_view((4.0, -7.0, 10.0), (0.3, -0.2, 0.1))
SOURCE = turned_view((-3.0, 5.0, -12.0), (-0.1, 0.15, -0.2), fx=90.0, fy=85.0, cx=44.0, cy=25.0, width=90)


@dataclass(frozen=True)
class Wall:
    """The plane normal . X = distance of the rig's frame, and where a view's pixels see it."""

    normal: Array
    distance: float

    def points(self, view: View, pixels: Array) -> Array:
        """The points (n, 3) that these pixels (n, 2) see."""
        rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(view.matrix).T @ view.rotation
        far = (self.distance - view.centre @ self.normal) / (rays @ self.normal)
        return np.asarray(view.centre + far[:, None] * rays)

    def inverse_depth(self, view: View) -> Array:
        """The inverse depth of every pixel."""
        z = depth_in(view, self.points(view, view.grid()))
        return (1 / z).reshape(view.height, view.width).astype(np.float32)

    def slopes(self, view: View) -> tuple[float, float]:
        """The change of inverse depth per pixel in x and y, the same everywhere."""
        at = 1 / depth_in(view, self.points(view, np.array([[0.0, 0], [1, 0], [0, 1]])))
        return float(at[1] - at[0]), float(at[2] - at[0])

    def surface(self, view: View) -> Surface:
        """The wall as a sweep would find it, at a cost of 0.1."""
        level = self.inverse_depth(view)
        x, y = self.slopes(view)
        return Surface(level, np.full_like(level, x), np.full_like(level, y), np.full_like(level, 0.1))


WALL = Wall(np.array([0.36, -0.48, 0.8]), 2.4)


def depth_in(view: View, points: Array) -> Array:
    """The depth (n,) of points (n, 3) along a view's axis."""
    return np.asarray((points - view.centre) @ view.rotation[2])


def pixels_of(view: View, points: Array) -> Array:
    """The pixels (n, 2) at which a view sees points (n, 3)."""
    seen = (points - view.centre) @ view.rotation.T @ view.matrix.T
    return np.asarray(seen[:, :2] / seen[:, 2:])


def image_of(view: View, window: int = 5, noise: float = 4.0) -> CalibratedImage:
    """The wall's picture; its paint is smooth, of waves along the rig's x and y."""
    points = WALL.points(view, view.grid())
    grey = (
        120 + 50 * np.sin(9 * points[:, 0] + 2 * points[:, 1]) + 40 * np.cos(11 * points[:, 1] - points[:, 0])
    )
    return CalibratedImage(view, grey.reshape(view.height, view.width).astype(np.float32), window, noise)


@pytest.fixture
def pair() -> SourceView:
    return SourceView(image_of(REFERENCE), image_of(SOURCE))


def test_a_pixel_is_projected_to_where_the_source_sees_the_wall(pair: SourceView) -> None:
    level = WALL.inverse_depth(REFERENCE)
    points = WALL.points(REFERENCE, REFERENCE.grid())
    true = pixels_of(SOURCE, points).T.reshape(2, *level.shape)
    x, y, z = pair.project(level)
    assert np.abs(np.stack([x, y]) - true).max() < 2e-3
    assert z / level == pytest.approx(depth_in(SOURCE, points).reshape(level.shape), rel=1e-5)
    few = pair.project(level[::8, ::8], every=8)
    assert all(np.allclose(part, whole[::8, ::8]) for part, whole in zip(few, (x, y, z), strict=True))


def test_what_is_behind_the_source_has_no_pixel_there() -> None:
    back = replace(SOURCE, rotation=np.diag([-1.0, 1.0, -1.0]) @ SOURCE.rotation)
    x, y, z = SourceView(image_of(REFERENCE), image_of(back)).project(WALL.inverse_depth(REFERENCE))
    assert (z < 0).all()
    assert np.isnan(x).all()
    assert np.isnan(y).all()


def test_the_kernels_numbers_project_as_arrays_do(pair: SourceView) -> None:
    x, y, _ = pair.project(np.full((60, 80), 0.7, np.float32))
    numbers = pair.numbers
    at = numbers[:9].reshape(3, 3) @ (17.0, 41.0, 1.0) + 0.7 * numbers[9:12]
    assert at[:2] / at[2] == pytest.approx((x[41, 17], y[41, 17]), abs=2e-3)
    assert numbers[12] == pair.source.noise


def test_motion_in_the_reference_is_the_derivative_at_infinity() -> None:
    reference = turned_view((4.0, -7.0, 10.0), (0.3, -0.2, 0.1), fx=72.0, fy=72.0)
    pair = SourceView(image_of(reference), image_of(SOURCE))
    at = np.array([[3.0, 50.0], [80.0, 7.0], [44.0, 25.0]])
    rays = np.column_stack([at, np.ones(3)]) @ np.linalg.inv(SOURCE.matrix).T @ SOURCE.rotation
    # w is the inverse of the depth along the source's axis.
    ends = [pixels_of(reference, SOURCE.centre + rays / w) for w in (1e-4, 2e-4)]
    moved = np.linalg.norm(ends[1] - ends[0], axis=1) / 1e-4
    assert pixels_per_inverse_depth(pair, *at.T.astype(np.float32)) == pytest.approx(moved, rel=1e-3)


def test_angle_is_between_the_rays_of_both_views(pair: SourceView) -> None:
    points = WALL.points(REFERENCE, REFERENCE.grid())
    sides = [points - view.centre for view in (REFERENCE, SOURCE)]
    cosine = (sides[0] * sides[1]).sum(1) / np.prod([np.linalg.norm(side, axis=1) for side in sides], axis=0)
    assert cosine_of_rays(pair, WALL.inverse_depth(REFERENCE)) == pytest.approx(
        cosine.reshape(60, 80), abs=1e-5
    )
    inside, angle = seen_points(REFERENCE, SOURCE, points)
    at = pixels_of(SOURCE, points)
    assert np.array_equal(inside, ((at >= 0) & (at < (SOURCE.width, SOURCE.height))).all(1))
    assert 0 < inside.mean() < 1
    assert angle == pytest.approx(np.degrees(np.arccos(cosine)), abs=1e-6)


def test_a_crop_and_a_smaller_image_keep_the_rays() -> None:
    image = image_of(REFERENCE)
    whole = image.rays
    assert np.allclose(whole.reshape(3, -1).T, REFERENCE.rays(REFERENCE.grid()), atol=1e-6)
    crop = image.cropped((slice(11, 50), slice(7, 70)))
    assert np.array_equal(crop.grey, image.grey[11:50, 7:70])
    assert crop.rays == pytest.approx(whole[:, 11:50, 7:70], abs=1e-6)
    assert image.cropped((slice(None), slice(0, 80))) is image
    half = image.scaled(0.5)
    assert (half.view.width, half.view.height) == (40, 30)
    # A pixel of the half covers four: its ray is their mean.
    four = (whole[:, ::2, ::2] + whole[:, 1::2, ::2] + whole[:, ::2, 1::2] + whole[:, 1::2, 1::2]) / 4
    assert half.rays == pytest.approx(four, abs=1e-6)
    assert image.scaled(1.0) is image


def test_only_what_is_noise_and_black_or_white_is_blank() -> None:
    grey = np.full((60, 80), 120.0, np.float32)
    grey[:, :20], grey[:, 60:] = 5.0, 252.0
    grey[30:] += np.where(np.arange(80) % 2, 12.0, -12.0).astype(np.float32)
    image = CalibratedImage(REFERENCE, np.clip(grey, 0, None), 5, 9.0)
    inner = (slice(4, 26), slice(None))
    assert image.blank[inner][:, :16].all()
    assert image.blank[inner][:, 64:].all()
    assert not image.blank[:, 24:56].any()
    assert not image.blank[36:].any()
    assert image.flat[inner][:, 24:56].all()
    assert not image.flat[36:, 24:56].any()
    # Stripes of 12 grey levels about the mean, two or three of five columns each, and noise.
    assert image.deviation[45, 40] == pytest.approx(np.sqrt(144 - 2.4**2 + 9), rel=1e-4)
    assert image.bordered.shape == (63, 83)
    assert (image.bordered[0] == OUTSIDE).all()
    assert np.array_equal(image.bordered[1:-2, 1:-2], image.grey)


@BOTH
def test_both_views_of_a_wall_agree_and_a_nearer_one_hides_it(steps: ModuleType, pair: SourceView) -> None:
    level, other = WALL.inverse_depth(REFERENCE), WALL.inverse_depth(SOURCE)
    inside, angle = seen_points(REFERENCE, SOURCE, WALL.points(REFERENCE, REFERENCE.grid()))
    # A pixel within half a pixel of the border is a matter of rounding.
    at = pixels_of(SOURCE, WALL.points(REFERENCE, REFERENCE.grid()))
    inner = (inside & ((at > 1) & (at < (SOURCE.width - 2, SOURCE.height - 2))).all(1)).reshape(60, 80)
    limits = Agreement(0.05, 0.0, 3.0, -1.0)
    same, able = steps.compare_surfaces(level, pair, other, limits)
    assert same[inner].all()
    assert able[inner].all()
    assert not able[~inside.reshape(60, 80) & (np.abs(at - 40) > 60).any(1).reshape(60, 80)].any()
    same, able = steps.compare_surfaces(level, pair, np.float32(1.2) * other, limits)
    assert not same.any()
    assert not able[inner].any()
    same, able = steps.compare_surfaces(level, pair, np.float32(0.8) * other, limits)
    assert not same.any()
    assert able[inner].all()
    # Off by 3 %, some pixels: fine if 4 % is always fine, and otherwise as far as it moves.
    off = np.float32(1.03) * other
    assert steps.compare_surfaces(level, pair, off, Agreement(0.05, 0.04, 0.0, -1.0))[0][inner].all()
    assert not steps.compare_surfaces(level, pair, off, Agreement(0.05, 0.0, 1e-3, -1.0))[0].any()
    xs, ys = SOURCE.grid().astype(np.float32).T
    moved = 0.03 * other * pixels_per_inverse_depth(pair, xs, ys).reshape(other.shape)
    limit = float(np.median(moved))
    part = steps.compare_surfaces(level, pair, off, Agreement(0.05, 0.0, limit, -1.0))[0][inner].mean()
    assert 0.1 < part < 0.9
    # Views from directions that differ by more than the limit say nothing.
    middle = float(np.cos(np.radians(np.median(angle))))
    same, able = steps.compare_surfaces(level, pair, other, Agreement(0.05, 0.0, 3.0, middle))
    narrow = (np.cos(np.radians(angle)) > middle).reshape(60, 80)
    assert np.array_equal(same[inner], narrow[inner])
    assert np.array_equal(able[inner], narrow[inner])


@BOTH
def test_the_other_image_is_warped_to_this_one(steps: ModuleType, pair: SourceView) -> None:
    warped = steps.warp(pair, WALL.inverse_depth(REFERENCE))
    at = pixels_of(SOURCE, WALL.points(REFERENCE, REFERENCE.grid())).reshape(60, 80, 2)
    inside = ((at >= 0) & (at <= (SOURCE.width - 1, SOURCE.height - 1))).all(2)
    assert 0.3 < inside.mean() < 1
    assert np.abs(warped - pair.reference.grey)[inside].max() < 3.5
    beyond = ((at < -1.1) | (at > (SOURCE.width + 0.1, SOURCE.height + 0.1))).any(2)
    assert (warped[beyond] == OUTSIDE).all()
    whole = cv2.erode(inside.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    assert whole.sum() > 500
    assert steps.costs_along([pair], WALL.inverse_depth(REFERENCE))[whole].max() < 40


@BOTH
def test_a_plane_is_its_own_fit(steps: ModuleType, pair: SourceView) -> None:
    true = WALL.surface(REFERENCE)
    slopes = np.stack(true[1:3])
    for given, rounds in ((None, 3), (slopes, 1), (slopes, 2)):
        level, right, down = steps.fit_planes(true.inverse_depth, 0.05, slopes=given, stride=2, rounds=rounds)
        inner = np.s_[5:-5, 5:-5]
        assert level[inner] == pytest.approx(true.inverse_depth[inner], abs=2e-5)
        # Regularized by a hundredth, where it begins at no slope.
        assert right[inner] == pytest.approx(true.slope_x[inner], rel=0.05)
        assert down[inner] == pytest.approx(true.slope_y[inner], rel=0.05)


def test_a_normal_stands_on_the_wall_and_faces_the_camera() -> None:
    true = WALL.surface(REFERENCE)
    normal = image_of(REFERENCE).surface_normals(*true[:3])
    expected = REFERENCE.rotation @ WALL.normal
    assert expected[2] > 0
    assert normal.reshape(-1, 3) == pytest.approx(np.tile(-expected, (60 * 80, 1)), abs=1e-3)


def test_a_surface_is_enlarged_on_its_own_planes() -> None:
    image = image_of(REFERENCE)
    half = WALL.surface(image.scaled(0.5).view)
    found = enlarge_surface(half, image)
    for part, true in zip(found[:3], WALL.surface(REFERENCE)[:3], strict=True):
        assert part == pytest.approx(true, rel=1e-3)


def test_motion_and_the_number_of_depths_follow_from_the_geometry() -> None:
    # Side by side and parallel, a point moves by focal length times distance times inverse depth.
    left, right = (turned_view((0, 0, 0), (x, 0, 0), fx=70.0, fy=70.0) for x in (0.0, 1.0))
    pair = SourceView(image_of(left), image_of(right))
    assert motion_px(pair, 0.2, 1.0) == pytest.approx(0.8 * 70, rel=1e-4)
    sizes = (pair.reference, [pair.source], (0.2, 1.0))
    scale, count = PlaneSweep().plan(*sizes)
    assert (scale, count) == (1.0, int(np.ceil(0.8 * 70 / STEP_PX) + 1))
    # With room for 30 depths at most, both sides shrink until the cells fit.
    scale, count = PlaneSweep(max_cells=30 * 80 * 60).plan(*sizes)
    assert scale == pytest.approx(2**-0.5)
    assert count == max(MIN_PLANES, int(np.ceil(0.8 * 70 * scale / STEP_PX) + 1))


@BOTH
def test_a_pixel_beside_its_surface_takes_the_neighbours_plane(
    steps: ModuleType, pair: SourceView, monkeypatch: pytest.MonkeyPatch
) -> None:
    if steps is array_sweep:
        sweep_by_arrays(monkeypatch)
    true = WALL.surface(REFERENCE)
    planes = np.stack(true[:3])
    for strip in (np.s_[:, 30:33], np.s_[28:31, :]):
        wrong = planes.copy()
        wrong[0][strip] *= 1.3
        moved = move_edges(wrong, [pair], 4)
        inner = np.s_[12:-12, 20:-20]
        off = np.abs(moved[0] - planes[0])[strip]
        assert np.median(off) < 1e-6
        assert np.abs(moved - planes)[1:].max() < 1e-6
        assert np.abs(moved[0] - planes[0])[inner].mean() < 0.5 * np.abs(wrong[0] - planes[0])[inner].mean()


def test_a_wall_in_the_rig_is_what_each_camera_sees_of_it() -> None:
    plane = ScenePlane(WALL.normal, WALL.distance)
    for view in (REFERENCE, SOURCE):
        image = image_of(view)
        level = np.tensordot(plane.inverse_depth_gradient(view), image.rays, 1)
        assert level == pytest.approx(WALL.inverse_depth(view), rel=1e-4)
        evident = np.ones(level.shape, bool)
        evident[:9] = False
        points = sample_surface(image, WALL.inverse_depth(view), evident)
        places, normals, centres = np.split(points.T, 3, axis=1)
        assert len(places) == (view.height - 9) * view.width
        assert places @ WALL.normal == pytest.approx(WALL.distance, rel=1e-4)
        assert np.median(normals @ WALL.normal) == pytest.approx(-1, abs=1e-3)
        assert centres[0] == pytest.approx(view.centre, abs=1e-6)
        # A plane 2 % farther along a ray is 2 % off it.
        away = np.hstack([view.centre + 1.02 * (places - centres), normals, centres]).T
        assert plane.contains(away, 0.0204).all()
        assert not plane.contains(away, 0.0196).any()


def test_a_wall_is_chosen_where_two_sources_see_it() -> None:
    other = turned_view((2.0, 8.0, 3.0), (0.1, 0.25, 0.0))
    parts = [
        BlankPart(image, image.grey, np.ones(image.grey.shape, bool), np.ones(image.grey.shape, bool))
        for image in (image_of(view, window=7) for view in (REFERENCE, SOURCE, other))
    ]
    level = WALL.inverse_depth(REFERENCE)
    points = WALL.points(REFERENCE, REFERENCE.grid())
    at = [pixels_of(view, points).reshape(60, 80, 2) for view in (SOURCE, other)]
    sizes = [np.array([view.width, view.height]) for view in (SOURCE, other)]
    inside = np.all(
        [((one > 4) & (one < size - 5)).all(2) for one, size in zip(at, sizes, strict=True)], axis=0
    )
    beyond = np.any(
        [((one < -4) | (one > size + 4)).any(2) for one, size in zip(at, sizes, strict=True)], axis=0
    )
    plane = ScenePlane(WALL.normal, WALL.distance)
    others = [part.image for part in parts[1:]]
    gradients, number, evident = choose_planes(parts[0], others, 1.3 * level, [plane], (0.5, 9.0))
    assert len(gradients) == 2
    inner = cv2.erode(inside.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    assert inner.sum() > 300
    assert np.mean(number[inner] == 1) > 0.7
    assert evident[inner & (number == 1)].all()
    assert 0.1 < beyond.mean() < 0.9
    assert (number[beyond] == AS_FOUND).all()
    # A surface that only noise matches is not evident.
    rng = np.random.default_rng(3)
    noise = [replace(other, grey=rng.normal(128, 9, other.grey.shape).astype(np.float32)) for other in others]
    _, number, evident = choose_planes(parts[0], noise, 1.3 * level, [plane], (0.5, 9.0))
    assert np.mean(evident[number == AS_FOUND]) < 0.05
    # A faint wall replaces a surface behind it, and none in front that is smooth and matches nearly as well.
    faint = [
        replace(image, grey=128 + 2 * wall / wall.std() + rng.normal(0, 9, wall.shape).astype(np.float32))
        for image, wall in ((one, one.grey - one.grey.mean()) for one in (parts[0].image, *others))
    ]
    blank = replace(parts[0], image=faint[0])
    for found, laid in ((1.3 * level, 0.0), (0.7 * level, 0.6)):
        number = choose_planes(blank, faint[1:], found, [plane], (0.5, 9.0))[1]
        assert np.mean(number[inner] == 1) == pytest.approx(laid, abs=0.15)
    # Where the sources do not see the surface as found, there is nothing to compare a plane with.
    unseen = choose_planes(parts[0], others, np.full_like(level, 0.05), [plane], (0.5, 9.0))
    assert (unseen[1] == AS_FOUND).all()
    assert not unseen[2].any()
    # A plane beyond the range of depths is none of the candidates.
    near = choose_planes(parts[0], others, level, [plane], (0.5, 0.6))
    assert len(near[0]) == 1
    # Nor is the part of a plane that lies beyond it.
    middle = float(np.median(level))
    partly = choose_planes(parts[0], others, 1.3 * level, [plane], (0.5, 1 / middle))
    assert len(partly[0]) == 2
    assert not (partly[1][level < middle] == 1).any()


def test_a_blank_part_keeps_its_shade_beside_texture() -> None:
    noise = np.random.default_rng(2).normal(0, 1, (REFERENCE.height, REFERENCE.width))
    grey = (100 + noise).astype(np.float32)
    grey[:, 45:] += 80 * (np.indices(grey.shape).sum(0)[:, 45:] % 2)
    part = extract_blank_part(CalibratedImage(REFERENCE, grey, 5, 9.0))
    assert part.there[2:-2, 2:9].all()
    assert not part.there[:, 13:].any()
    assert np.abs(part.shade - 100)[part.there].max() < 2
    assert np.abs(part.image.grey - 128)[part.there].max() < 2
    assert (part.image.grey[~part.there] == 128).all()
    assert part.image.noise == pytest.approx(9.0 / 16, rel=0.05)


def test_no_planes_are_sought_where_hardly_anything_is_blank(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blank_walls, "find_scene_planes", lambda *_: pytest.fail("there are no walls"))
    rng = np.random.default_rng(4)
    images = {
        name: replace(image_of(view), grey=rng.normal(128, 60, (60, view.width)).astype(np.float32))
        for name, view in (("a", REFERENCE), ("b", SOURCE))
    }
    surfaces = {
        name: Surface(*np.ones((4, 60, image.view.width), np.float32)) for name, image in images.items()
    }
    ranges = dict.fromkeys(images, (0.5, 9.0))
    with ThreadPoolExecutor(1) as pool:
        laid, planes = fit_blank_walls(images, {"a": ("b",), "b": ("a",)}, ranges, surfaces, pool)
    assert planes is None
    assert all(laid[name] is surfaces[name] for name in images)


def test_a_laid_wall_goes_on_behind_what_windows_made_too_wide() -> None:
    image = image_of(REFERENCE)
    true = WALL.surface(REFERENCE)
    grey = np.full((60, 80), 120.0, np.float32)
    # A rod; windows give its depth to four columns on each side, too, and to some rows above it.
    grey[20:, 38:42] = 40.0
    image = replace(image, grey=grey)
    rod = np.zeros((60, 80), bool)
    rod[17:, 34:46] = True
    found = Surface(*(np.full((60, 80), value, np.float32) for value in (0.5, 0.0, 0.0, 0.9)))
    found.inverse_depth[rod], found.cost[rod] = 1.5, 0.1
    found.cost[0, 0] = 0.1
    gradient = ScenePlane(WALL.normal, WALL.distance).inverse_depth_gradient(REFERENCE)
    number = np.full((30, 40), 1)
    choice = np.stack([np.zeros(3, np.float32), gradient]), number, np.ones((30, 40), bool)
    laid = lay_planes(found, image, ~rod, choice)
    wall = np.ones((60, 80), bool)
    wall[20:, 38:42] = wall[0, 0] = False
    for part, exact in zip(laid[:3], true[:3], strict=True):
        assert part[wall] == pytest.approx(exact[wall], rel=1e-4)
    assert (laid.inverse_depth[20:, 38:42] == 1.5).all()
    # A pixel with evidence of its own keeps its depth, and only its neighbours could continue it.
    assert laid.inverse_depth[0, 0] == 0.5
    assert (laid.cost[~rod] <= 0.45).all()
    assert (laid.cost[rod] == np.float32(0.1)).all()
    # Where no plane was chosen, or other evidence is there, all stays.
    nothing = lay_planes(found, image, ~rod, (choice[0], 0 * number + AS_FOUND, choice[2]))
    assert (nothing.inverse_depth[~rod] == 0.5).all()
    found.cost[:] = 0.2
    assert np.array_equal(lay_planes(found, image, ~rod, choice).inverse_depth[:10], found.inverse_depth[:10])


def test_other_views_propose_their_nearest_surface() -> None:
    # Walls that face this view have one depth in it, whoever measured them.
    axis = REFERENCE.rotation[2]
    walls = [Wall(axis, float(REFERENCE.centre @ axis) + depth) for depth in (2.0, 3.0)]
    to_this = SourceView(image_of(SOURCE), image_of(REFERENCE))
    near, far = (1 / wall.inverse_depth(SOURCE) for wall in walls)
    near[:, 45:] = 0
    at = pixels_of(REFERENCE, walls[1].points(SOURCE, SOURCE.grid()))
    found = propose_inverse_depth([(to_this, near), (to_this, far)], (60, 80))
    assert {round(float(value), 4) for value in np.unique(found)} == {0.0, 0.3333, 0.5}
    hit = np.zeros((60, 80), bool)
    columns, rows = np.rint(at[((at > 0) & (at < (79, 59))).all(1)]).astype(int).T
    hit[rows, columns] = True
    assert (found[hit] > 0).all()
    assert (found[found == 0].size) < 0.9 * found.size
    only = propose_inverse_depth([(to_this, far)], (60, 80))
    assert not (only > 0.34).any()
    assert not propose_inverse_depth([], (4, 5)).any()


def test_points_are_at_the_pixels_that_see_them() -> None:
    at = np.array([[3.0, 50.0], [70.0, 7.0], [31.0, 36.0], [0.0, 0.0], [79.0, 59.0]])
    pixels, z, inside = project_points(REFERENCE, WALL.points(REFERENCE, at))
    assert inside.all()
    assert np.array_equal(np.column_stack(np.divmod(pixels, REFERENCE.width)[::-1]), at)
    assert z == pytest.approx(depth_in(REFERENCE, WALL.points(REFERENCE, at)), rel=1e-5)
    beside = WALL.points(REFERENCE, np.array([[-1.0, 5], [5, -1], [80, 5], [5, 60]]))
    assert not project_points(REFERENCE, beside)[2].any()
    behind = 2 * REFERENCE.centre - WALL.points(REFERENCE, at)
    assert not project_points(REFERENCE, behind)[2].any()


def test_points_near_others_are_those_within_the_tolerance() -> None:
    rng = np.random.default_rng(6)
    points, asked = (rng.uniform(-0.1, 0.1, (count, 3)).astype(np.float32) for count in (2000, 700))
    apart = np.linalg.norm(points[:, None] - asked, axis=2).min(0)
    near = int((apart < TOLERANCE_M).sum())
    assert 200 < near < 500
    assert count_near(points, asked) == (near, 700)


def test_the_best_angles_are_worth_most() -> None:
    low, high = BEST_ANGLES_DEG
    worth = angle_fitness(
        np.array([0.5, (0.5 + low) / 2, low, high, (high + MAX_ANGLE_DEG) / 2, MAX_ANGLE_DEG])
    )
    assert worth == pytest.approx([0, 0.5, 1, 1, 0.25, 0])


def test_sources_are_the_others_that_see_the_same_best_first() -> None:
    # All are parallel and 4 m from the points: the farther aside a camera is, the less of the view it sees.
    views = {f"cam{k}": turned_view((0, 0, 0), (0.25 * k, 0, 0)) for k in range(7)}
    points = {name: view.unproject(view.grid()[::37], np.full(130, 4.0)) for name, view in views.items()}
    chosen = choose_source_views(views, points)
    assert chosen["cam0"] == ("cam1", "cam2", "cam3", "cam4")
    assert {*chosen["cam3"]} == {"cam1", "cam2", "cam4", "cam5"}


def test_only_cameras_of_one_step_are_matched() -> None:
    views = {f"cam{k}": turned_view((0, 0, 0), (0.25 * k, 0, 0)) for k in range(5)}
    points = {name: view.unproject(view.grid()[::37], np.full(130, 4.0)) for name, view in views.items()}
    steps_ns = dict(zip(views, (0, 5, 0, 5, 9), strict=True))
    chosen = choose_source_views(views, points, steps_ns)
    assert chosen == {"cam0": ("cam2",), "cam2": ("cam0",), "cam1": ("cam3",), "cam3": ("cam1",), "cam4": ()}


def test_a_scene_is_found_where_it_is() -> None:
    views = {"a": REFERENCE, "b": SOURCE, "c": turned_view((0, 0, 0), (0.1, 0.3, 0.0))}
    scene = find_rough_scene({name: image_of(view) for name, view in views.items()})
    for name, points in scene.points.items():
        assert np.median(np.abs(points @ WALL.normal - WALL.distance)) < 0.02 * WALL.distance
        depth = depth_in(views[name], points)
        nearest, farthest = scene.depth_ranges[name]
        assert nearest < depth.min()
        assert farthest > np.percentile(depth, 99)
        assert nearest > 0.6 * depth.min()
        assert farthest < 2.0 * depth.max()


def test_a_point_is_drawn_on_its_side_of_the_picture() -> None:
    views = [turned_view((0, 0, 0), (x, 0, 0)) for x in (-0.2, 0.2)]
    assert up_direction([view.rotation for view in views]) == pytest.approx([0, -1, 0])
    axes = np.array([[0, 0, 2.0], [0.5, 0, 2.0], [0, 0.5, 2.0]])
    colours = np.array([[0, 0, 0], [255, 0, 0], [0, 0, 255]], np.uint8)
    cloud = np.repeat(axes, [5, 2, 2], axis=0), np.repeat(colours, [5, 2, 2], axis=0)
    picture = draw_clouds({"": cloud}, views)[""]
    assert picture.shape == (720, 1440, 3)
    middle = [
        np.mean(np.nonzero((picture[:360, 480:960] == colour[::-1]).all(2)), axis=1) for colour in colours
    ]
    # Rows first: the red point is to the right of the centre, the blue one below it.
    assert middle[0] == pytest.approx((180, 240), abs=1)
    assert middle[1][1] > 260
    assert middle[2][0] > 200
    # A square that the border would cut is left out, and none goes on at the other side.
    ground = picture[0, 0]
    beyond = axes[0] + np.outer(np.linspace(0, 4, 2000), [1, 0, 0])
    wide = np.vstack([axes.repeat(3000, axis=0), beyond])
    row = draw_clouds({"": (wide, np.full(wide.shape, 255, np.uint8))}, views)[""][180, 480:960]
    assert (row[-6:-3] != ground).all()
    assert (row[:200] == ground).all()


def test_large_clouds_are_drawn_thinned_and_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mesh, "MAX_SHOWN_POINTS", 4)
    views = [turned_view((0, 0, 0), (x, 0, 0)) for x in (-0.2, 0.2)]
    few = np.array([[0, 0, 2.0], [0.1, 0.2, 2.1], [-0.2, 0.1, 2.0]])
    many = np.tile([0.3, -0.2, 2.2], (9, 1))
    # Each third of nine points is drawn.
    many[::3] = few
    clouds = {
        name: (points, np.full(points.shape, 200, np.uint8))
        for name, points in (("few", few), ("many", many))
    }
    drawn = draw_clouds(clouds, views)
    assert np.array_equal(drawn["few"], drawn["many"])


def test_parallel_cameras_overlap_from_near_to_infinity() -> None:
    views = {name: turned_view((0, 0, 0), (x, 0, 0)) for name, x in (("left", 0.0), ("right", 0.2))}
    overlap = find_overlaps(views, "left")["right"]
    nearest = 0.2 * 75 / 80
    assert overlap.span[0] == 0.0
    assert 1 < 1 / (nearest * overlap.span[1]) < 4


def test_crossed_cameras_overlap_where_their_rays_cross() -> None:
    narrow = {"fx": 200.0, "fy": 190.0, "cx": 40.0}
    left, right = (turned_view((0, -15 * side, 0), (-0.2 * side, 0, 0), **narrow) for side in (1, -1))
    far, near = (1 / one for one in find_overlaps({"left": left, "right": right}, "left")["right"].span)
    # The axes meet at 0.75; beyond 3.1 no ray of one is in the other's picture.
    assert near < 0.75 < 1.5 < far < 3.1


def test_a_view_sees_a_point_at_its_depth_and_not_what_is_hidden() -> None:
    true = 1 / WALL.inverse_depth(REFERENCE)
    points = WALL.points(REFERENCE, np.array([[10.0, 12.0], [60.0, 41.0]]))
    for off, seen in ((0.0, True), (0.7, True), (-0.7, True), (1.4, False), (-1.4, False)):
        away = REFERENCE.centre + (1 + off * VISIBLE_FRACTION) * (points - REFERENCE.centre)
        assert (visible_points(REFERENCE, true, away) == seen).all()
