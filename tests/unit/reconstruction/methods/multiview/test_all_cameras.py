"""The parts of a comparison that take all cameras: depth of the middle one, the cloud, and what cannot be."""

from pathlib import Path

import numpy as np
import pytest

from capture_app.session.reading.reader import Session
from reconstruction.common.matchers import Matcher
from reconstruction.method.score import Context
from reconstruction.methods.multiview.colmap_workspace import fuse_by_colmap
from reconstruction.methods.multiview.fusion import FusedCloud
from reconstruction.methods.multiview.instant_depth import InstantDepth
from reconstruction.methods.multiview.instant_scoring import (
    count_near,
    points_on_masks,
    points_on_moving,
    true_surfaces,
)
from reconstruction.methods.multiview.multiview_study import MultiviewStudy, save_clouds
from reconstruction.methods.multiview.sweep_matcher import ViewDepth
from reconstruction.pages.embedding import view_clouds
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene as OpenScene
from tests.unit.reconstruction.conftest import Scene, make_view, write_session
from tests.unit.reconstruction.methods.multiview.conftest import VIEWS


def multiview(
    session: Session,
    *,
    instants: int = 1,
    width: int = 640,
    middle: int = 2,
    matcher: Matcher = Matcher.AUTO,
) -> MultiviewStudy:
    """A study of a calibrated session."""
    options = {"max_multiview_instants": instants, "multiview_width": width, "matcher": matcher}
    opened = open_scene(session)
    return MultiviewStudy(Context(scene=opened, step=2, middle=middle, options=options))


def open_scene(session: Session) -> OpenScene:
    return OpenScene(Dataset(session))


def test_what_cannot_be_says_why(scene: Scene, tmp_path: Path) -> None:
    pair = {name: VIEWS[name] for name in ("left", "right")}
    two = multiview(write_session(tmp_path / "two", scene, pair, instants=2), middle=0)
    with pytest.raises(ValueError, match=r"^it takes 3 cameras with overlapping views$"):
        two.prepare()
    aside = {**pair, "away": make_view((0.1, 0, 0), yaw=60)}
    apart = multiview(write_session(tmp_path / "apart", scene, aside, instants=2), middle=0)
    with pytest.raises(ValueError, match="away: overlaps too little with any two others"):
        apart.prepare()


def test_a_side_without_a_point_is_not_shown(tmp_path: Path) -> None:
    view = VIEWS["middle"]
    nothing = np.zeros((view.height, view.width), np.float32)
    colours = np.full((5000, 3), 200, np.uint8)
    points = np.random.default_rng(0).normal((0, 0, 3), 0.3, (5000, 3)).astype(np.float32)
    maps = {
        side: InstantDepth({}, FusedCloud(points[:kept], points[:kept], colours[:kept], nothing))
        for side, kept in (("synced", 5000), ("offset", 0))
    }
    clouds = save_clouds(3, maps, nothing, view, nothing > 0, tmp_path)
    assert clouds is not None
    shown = view_clouds(clouds, tmp_path, "middle", 3)
    assert shown["synced"]["points"] > 4000
    assert shown["offset"] is None


def test_colmap_fuses_the_maps_of_all_cameras_that_an_instant_has() -> None:
    views = {f"cam{k}": make_view((0.1 * k, 0, 0)) for k in range(3)}
    flat = np.full((240, 320), 2.0, np.float32)
    facing = np.tile(np.array([0, 0, -1], np.float16), (240, 320, 1))
    maps = dict.fromkeys(views, ViewDepth(flat, facing))
    colours = {name: np.full((240, 320, 3), 90, np.uint8) for name in views}
    points, painted = fuse_by_colmap(views, colours, maps, 3)
    assert len(points) > 10_000
    assert points[:, 2] == pytest.approx(2.0, abs=1e-3)
    assert (painted == 90).all()


def test_a_cloud_is_held_against_true_surfaces() -> None:
    views = {"a": make_view((-0.1, 0, 0)), "b": make_view((0.1, 0, 0))}
    depth = {name: np.full((240, 320), 2.0, np.float32) for name in views}
    movers = {name: np.zeros((240, 320), bool) for name in views}
    for mask in movers.values():
        mask[:, :160] = True
    surfaces = true_surfaces(views, depth, movers, ["mover", "static"])
    wall = np.array([(x, y, 2.0) for x in np.linspace(-0.5, 0.5, 120) for y in np.linspace(-0.5, 0.5, 120)])
    near = [count_near(surfaces[kind][0], wall)[0] for kind in ("mover", "static")]
    assert sum(near) >= len(wall)
    assert min(near) > 0.3 * len(wall)
    assert count_near(surfaces["static"][0], wall + np.array([0, 0, 0.02]))[0] == 0
    right, asked = count_near(wall, surfaces["static"][1])
    assert 0 < right < asked
    assert count_near(np.zeros((0, 3)), wall[:5]) == (0, 5)
    on_masks = points_on_masks(np.array([[-0.5, 0.0, 2.0], [0.6, 0.0, 2.0]]), views, movers)
    assert on_masks.tolist() == [True, False]


def test_a_point_is_on_a_mover_where_most_that_saw_it_show_one() -> None:
    views = {name: make_view((x, 0, 0)) for name, x in (("a", -0.1), ("b", 0.0), ("c", 0.1))}
    yes, no = np.ones((240, 320), bool), np.zeros((240, 320), bool)
    points = np.array([[0.0, 0.0, 2.0]] * 3)
    seen = np.array([[True, True, True], [True, False, True], [False, True, True]])
    on_movers = points_on_moving(points, seen, views, {"a": yes, "b": yes, "c": no})
    assert on_movers.tolist() == [True, False, False]
    assert points_on_moving(points[:0], seen[:0], views, {"a": yes, "b": no, "c": no}).tolist() == []
