"""New views of a moment that is known exactly."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from reconstruction.common.camera_paths import orbit, read_path, swing
from reconstruction.depth.seen_moment import find_subject, load_moment, save_moment
from reconstruction.depth.view_blending import fill, render, surface_seen
from reconstruction.method.picture_quality import psnr, ssim
from tests.unit.reconstruction.depth.moments import BOARD_M, WALL_M, moment, seen, view_at


@pytest.mark.parametrize(("x", "turn", "least"), [(-0.12, 0.0, 27), (0.1, 0.05, 27), (0.25, 0.0, 35)])
def test_a_view_between_cameras_is_what_a_camera_there_would_see(x: float, turn: float, least: float) -> None:
    view = view_at(x, 0.02 if x < 0.2 else 0.0, 0.0, turn)
    truth, made = seen(view), render(view, moment())
    assert psnr(made.colours, truth.colours, made.known) > least
    assert ssim(made.colours, truth.colours) > 0.93
    assert made.known.mean() > 0.95
    right = np.abs(made.depth - truth.depth) < 0.02 * truth.depth
    assert right[made.known].mean() > 0.96


def test_the_nearest_picture_is_worse_than_the_blended_one() -> None:
    view, all_cameras = view_at(-0.12, 0.02), moment()
    one = render(view, {"left": all_cameras["left"]})
    truth = seen(view).colours
    assert psnr(one.colours, truth) < psnr(render(view, all_cameras).colours, truth)


def test_depth_that_no_other_map_confirms_is_passed_by() -> None:
    cameras = moment()
    wrong = cameras["left"].depth.copy()
    wrong[20:30, 20:30] = 1.0
    cameras = {**cameras, "left": replace(cameras["left"], depth=wrong)}
    wrong_alone = surface_seen(view_at(-0.1), {"left": cameras["left"]}) < 0.9 * BOARD_M
    assert wrong_alone[10:80, 10:110].sum() > 80
    assert (surface_seen(view_at(-0.1), cameras)[10:80, 10:110] < 0.9 * BOARD_M).sum() < 30


def test_what_a_board_hid_is_filled_from_the_wall() -> None:
    cameras = {"left": moment()["left"]}
    made, truth = render(view := view_at(0.1), cameras), seen(view)
    hidden = ~made.known & (truth.depth > 0.9 * WALL_M)
    assert hidden[:, 20:100].any()
    near = made.known & (made.depth < 1.05 * BOARD_M)
    wall, board = made.colours[made.known & ~near].mean(), made.colours[near].mean()
    assert abs(made.colours[hidden].mean() - wall) < abs(made.colours[hidden].mean() - board) + 20


def test_holes_take_the_far_colour_and_known_pixels_stay() -> None:
    colours = np.full((40, 60, 3), 200, np.float32)
    depth = np.full((40, 60), 4.0, np.float32)
    colours[:, :30], depth[:, :30] = 20, 1.0
    depth[:, 28:34] = 0
    filled = fill(colours, depth)
    assert filled[:, 28:34].min() > 180
    assert (filled[:, :28] == 20).all()
    assert (filled[:, 34:] == 200).all()


def test_nothing_is_seen_from_behind() -> None:
    made = render(view_at(0.0, 0.0, 5.0), moment())
    assert not made.known.any()
    assert made.colours.shape == (90, 120, 3)


def test_a_saved_moment_is_the_same(tmp_path: Path) -> None:
    cameras = moment()
    save_moment(tmp_path / "maps", cameras, "m")
    again = load_moment(tmp_path / "maps")
    view = view_at(0.1)
    assert np.array_equal(render(view, again).colours, render(view, cameras).colours)


@pytest.mark.parametrize("path", [swing, orbit])
def test_a_path_stays_within_the_rig_and_holds_the_subject(path: Callable[..., Any]) -> None:
    cameras = moment()
    subject = find_subject(cameras)
    views = {name: one.view for name, one in cameras.items()}
    made = path(views, subject, 24)
    centres = np.array([view.centre for view in made])
    assert np.abs(centres[:, 0]).max() <= 0.27
    assert np.ptp(centres[:, 0]) > 0.3
    assert np.linalg.norm(centres[0] - centres[-1]) < 0.1
    pixels = [view.project((view.rotation @ subject + view.translation)[None])[0] for view in made]
    assert np.ptp(np.array(pixels), axis=0).max() < 1e-6


def test_a_path_goes_along_cameras_that_stand_around() -> None:
    subject = np.array([0.0, 0.0, 2.0])
    views = {}
    for number, angle in enumerate(np.linspace(-1.2, 1.2, 5)):
        place = subject + 2 * np.array([np.sin(angle), 0, -np.cos(angle)])
        views[f"cam{number}"] = view_at(float(place[0]), 0.0, float(place[2]), -angle)
    made = swing(views, subject, 40)
    ranges = [np.linalg.norm(view.centre - subject) for view in made]
    assert min(ranges) > 1.8
    assert max(ranges) < 2.2
    assert np.linalg.norm(made[0].centre - views["cam0"].centre) < 1e-9
    assert np.linalg.norm(made[20].centre - views["cam4"].centre) < 1e-9


def test_size_of_a_view_is_reduced_with_its_depth() -> None:
    small = moment()["left"].resized(60)
    assert small.colours.shape[:2] == small.depth.shape == (45, 60)
    assert (small.view.width, small.view.height) == (60, 45)
    assert set(np.unique(small.depth)) <= {BOARD_M, WALL_M} | set(np.unique(moment()["left"].depth))


def test_paths_from_files(tmp_path: Path) -> None:
    view = view_at(0.1, 0.0, -0.2, 0.1)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = view.rotation.T * [1.0, -1.0, -1.0], view.centre
    fov = np.degrees(2 * np.arctan(90 / 2 / 110.0))
    path = {"camera_to_world": pose.ravel().tolist(), "fov": fov, "aspect": 4 / 3}
    content = {"render_width": 120, "render_height": 90, "camera_path": [path, path]}
    (tmp_path / "path.json").write_text(json.dumps(content))
    for one in read_path(tmp_path / "path.json"):
        assert one.matrix == pytest.approx(view.matrix)
        assert one.translation == pytest.approx(view.translation)
    for text in ("{}", '{"cameras": {}}', "no JSON", '{"camera_path": [{}]}'):
        (tmp_path / "bad.json").write_text(text)
        with pytest.raises(BadInputError, match="no path of a camera"):
            read_path(tmp_path / "bad.json")
