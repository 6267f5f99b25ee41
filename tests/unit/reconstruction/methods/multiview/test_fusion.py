"""Points that views see through, or see from behind, are denied by them, and no points of a cloud."""

from pathlib import Path

import numpy as np
import pytest

from capture_app.session.exporting.point_cloud import read_ply
from reconstruction.common.geometry import Array, View
from reconstruction.methods.multiview.colmap_workspace import write_workspace
from reconstruction.methods.multiview.fusion import find_denied, fuse_maps, fuse_posed_maps
from reconstruction.methods.multiview.sweep_matcher import ViewDepth
from tests.unit.reconstruction.conftest import make_view
from tests.unit.reconstruction.depth.small_views import HEIGHT, MATRIX, SLOPE, WIDTH, photo_of, view_at


def wall(depth: float) -> ViewDepth:
    """What a camera measures that looks straight at a wall."""
    normals = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    normals[..., 2] = -1
    return ViewDepth(np.full((HEIGHT, WIDTH), depth, np.float32), normals)


def opposite(z: float) -> View:
    """A camera that looks back along z from there."""
    turned = np.diag([-1.0, 1.0, -1.0])
    return View(WIDTH, HEIGHT, MATRIX, np.zeros(5), turned, -turned @ np.array([0, 0, z]))


def denied(views: dict[str, View], maps: dict[str, ViewDepth], *points: tuple[float, ...]) -> list[bool]:
    """Which points of surfaces that face us are denied."""
    facing = np.tile((0.0, 0.0, -1.0), (len(points), 1))
    return [bool(one) for one in find_denied(np.array(points, np.float32), facing, views, maps)]


def test_a_view_denies_what_it_sees_through_and_not_what_is_hidden_from_it() -> None:
    views = {"left": view_at(-0.1), "right": view_at(0.1)}
    maps = {name: wall(2.0) for name in views}
    points = (0, 0, 1.5), (0, 0, 2.0), (0, 0, 2.005), (0, 0, 2.5)
    assert denied(views, maps, *points) == [True, False, False, False]
    # One that measured nothing says nothing, and at the edge of what was measured nothing is clear.
    maps["right"].depth[:] = 0
    maps["left"].depth[:, : WIDTH // 2] = 0
    assert denied(views, maps, (-0.1, 0, 1.5), (0.3, 0, 1.5)) == [False, True]
    assert denied(views, maps, (9.0, 0, 1.5), (0, 0, -1.0)) == [False, False]


def test_a_surface_is_not_seen_from_behind_but_by_whom_a_thickness_is_in_between() -> None:
    views = {"back": opposite(4.0)}
    assert denied(views, {"back": wall(2.0)}, (0, 0, 2.0)) == [True]
    assert denied(views, {"back": wall(1.9)}, (0, 0, 2.0)) == [False]


def test_over_twice_as_many_who_measured_just_that_depth_count_for_more() -> None:
    views = {"back": opposite(4.0)} | {f"front{k}": view_at(0.05 * k) for k in range(3)}
    maps = {name: wall(2.0) for name in views}
    assert denied(views, maps, (0, 0, 2.0)) == [False]
    maps["front2"] = wall(1.8)
    assert denied(views, maps, (0, 0, 2.0)) == [True]


def flake(others: int) -> tuple[dict[str, View], dict[str, ViewDepth], dict[str, Array]]:
    """Views and maps of a wall, with a patch before it that three of them measured; and grey pictures."""
    views = {f"cam{k}": view_at(0.08 * k) for k in range(3 + others)}
    maps = {name: wall(2.0) for name in views}
    for k in range(3):
        # A patch 1.6 away, each pixel of it at one place for all three.
        left = 48 + round(0.08 * (1 - k) * MATRIX[0, 0] / 1.6)
        maps[f"cam{k}"].depth[36:60, left : left + 32] = 1.6
    pictures = {name: np.full((HEIGHT, WIDTH, 3), (90, 70, 50), np.uint8) for name in views}
    return views, maps, pictures


@pytest.mark.parametrize(("others", "flake_left"), [(1, True), (2, False)])
def test_what_half_as_many_see_through_as_found_it_is_in_no_cloud(others: int, flake_left: bool) -> None:
    views, maps, pictures = flake(others)
    points, normals, colours, seen = fuse_maps(views, maps, pictures, len(views))
    assert len(points) == len(normals) == len(colours) == len(seen)
    assert (seen.sum(1) >= 3).all()
    assert (colours == (50, 70, 90)).all()
    assert np.allclose(normals, (0, 0, -1), atol=1e-5)
    assert (points[:, 2] > 1.9).sum() > 1000
    assert bool((points[:, 2] < 1.7).sum() > 100) is flake_left
    assert flake_left or not (points[:, 2] < 1.7).any()


def test_a_view_without_a_map_is_in_no_point() -> None:
    views, maps, pictures = flake(2)
    del maps["cam1"]
    seen = fuse_maps(views, maps, pictures, len(views)).seen
    assert seen.any(0).tolist() == [True, False, True, True, True]


def test_points_are_as_those_of_colmaps_fusion(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no package for this machine")
    views = {f"cam{k}": view_at(0.08 * k, 0.03 * (k % 2)) for k in range(4)}
    rng = np.random.default_rng(2)
    maps = {}
    for name, view in views.items():
        # A slanted wall, measured with an error that some pixels of other views do not share, and with holes.
        depth = photo_of(view)[1] * rng.normal(1, 0.006, (HEIGHT, WIDTH))
        depth[rng.random(depth.shape) < 0.1] = 0
        normals = np.full((HEIGHT, WIDTH, 3), (*SLOPE, -1.0)) / np.linalg.norm((*SLOPE, -1.0))
        maps[name] = ViewDepth(depth.astype(np.float32), normals.astype(np.float32))
    pictures = {name: np.full((HEIGHT, WIDTH, 3), 90, np.uint8) for name in views}
    write_workspace(tmp_path, views, pictures, maps)
    options = pycolmap.StereoFusionOptions()
    options.min_num_pixels, options.max_traversal_depth, options.num_threads = 3, 2, 1
    options.max_depth_error, options.max_normal_error, options.max_reproj_error = 0.01, 30.0, 1.5
    cloud = tmp_path / "fused.ply"
    pycolmap.stereo_fusion(str(cloud), str(tmp_path), "COLMAP", "option-all", "geometric", options, "ply")
    theirs, ours = read_ply(cloud).points, fuse_maps(views, maps, pictures, len(views)).points
    assert len(ours) == pytest.approx(len(theirs), rel=0.01)
    apart = np.linalg.norm(ours[::50, None] - theirs, axis=2).min(1)
    # COLMAP's points are medians of their pixels, ours are means.
    assert np.quantile(apart, 0.98) < 0.01


def test_maps_and_pictures_of_other_sizes_are_refused() -> None:
    view, depth = make_view((0, 0, 0)), np.ones((240, 320), np.float32)
    normals, picture = np.zeros((240, 320, 3), np.float32), np.zeros((240, 320, 3), np.uint8)
    for other in ((view, depth, normals[:9], picture), (view, depth, normals, picture[:, :9])):
        with pytest.raises(ValueError, match=r"a depth map of \(240, 320\) has normals or a picture"):
            fuse_posed_maps([(view, depth, normals, picture), other], 2, 0.01, 0.5)
