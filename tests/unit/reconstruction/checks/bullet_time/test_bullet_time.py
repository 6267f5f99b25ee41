"""The bullet-time sweep: cameras in the order of their places, the subject held still, honest pictures."""

from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest

from capture_app.session.reading.reader import Session
from reconstruction.checks.bullet_time.bullet_time_study import (
    LONG_SIDE_PX,
    MANY_CAMERAS,
    SMALLER_PX,
    _canvas_size,
    project_point,
    render_camera_sweep,
    render_view,
    save_animation,
    stabilize_views,
    triangulate_subject,
)
from reconstruction.common.camera_paths import order_of_views
from reconstruction.common.geometry import View
from reconstruction.method.comparison_results import CompareResult
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.moving_pixels import SceneMotion
from reconstruction.scene.scene import Scene as OpenScene
from tests.unit.reconstruction.conftest import HEIGHT, WIDTH, jump, make_view


def on_arc(angle_deg: float, radius: float = 3.0, roll: float = 0.0) -> View:
    """A camera on an arc around (0, 0, 3) that looks at it."""
    angle = np.radians(angle_deg)
    at = (radius * np.sin(angle), 0.0, 3.0 - radius * np.cos(angle))
    return make_view(at, yaw=-angle_deg, roll=roll)


def test_the_walk_follows_a_row_whatever_the_names() -> None:
    row = {
        name: make_view((x, 0.0, 0.0)) for name, x in zip("dbaec", (-0.4, -0.2, 0.0, 0.2, 0.4), strict=True)
    }
    assert order_of_views(row) == ("d", "b", "a", "e", "c")


def test_the_walk_goes_round_a_ring_and_never_across() -> None:
    angles = dict(zip("abcdefgh", (45, 180, 0, 270, 90, 225, 135, 315), strict=True))
    walk = order_of_views({name: on_arc(angle) for name, angle in angles.items()})
    steps = [(angles[b] - angles[a]) % 360 for a, b in pairwise(walk)]
    assert set(steps) in ({45}, {315})


def test_cameras_in_one_spot_are_walked_from_left_to_right() -> None:
    names = order_of_views(
        {"r": make_view((0, 0, 0), yaw=30), "l": make_view((0, 0, 0), yaw=-30), "m": make_view((0, 0, 0))}
    )
    assert names == ("l", "m", "r")


def test_what_cameras_saw_is_placed_where_it_is() -> None:
    views = {name: on_arc(angle) for name, angle in zip("abc", (-20, 0, 15), strict=True)}
    point = np.array([0.1, -0.2, 2.7])
    seen = {name: project_point(view, point) for name, view in views.items()}

    placed, miss = triangulate_subject(views, seen)
    assert placed == pytest.approx(point, abs=1e-6)
    assert miss < 1e-3

    seen["a"] = seen["a"] + (0.5 * WIDTH, 0)
    assert triangulate_subject(views, seen) is None
    assert triangulate_subject(views, {"a": seen["b"]}) is None


def test_no_point_is_held_that_a_camera_does_not_show() -> None:
    views = {"a": on_arc(-10), "b": on_arc(10), "aside": make_view((0, 0, 0), yaw=120)}
    seen = {name: np.array([WIDTH / 2, HEIGHT / 2]) for name in "ab"}
    assert triangulate_subject(views, seen) is None


def test_held_views_show_the_point_at_one_place_and_one_scale() -> None:
    point = np.array([0.0, 0.0, 3.0])
    views = {"a": on_arc(-25, 2.6, roll=8), "b": on_arc(0), "c": on_arc(25, 3.5, roll=-5)}
    held = stabilize_views(views, point, 200, 150)
    assert held is not None

    places = [project_point(view, point) for view in held.values()]
    assert np.ptp(places, axis=0) == pytest.approx([0, 0], abs=1e-6)
    below = point + np.array([0, 0.3, 0])
    heights = [project_point(view, below)[1] - project_point(view, point)[1] for view in held.values()]
    assert heights == pytest.approx([heights[0]] * 3, rel=1e-3)
    for name, view in held.items():
        assert view.centre == pytest.approx(views[name].centre)


def test_a_held_picture_is_filled_with_what_the_camera_saw() -> None:
    views = {name: on_arc(angle) for name, angle in zip("abc", (-15, 0, 15), strict=True)}
    held = stabilize_views(views, np.array([0.0, 0.0, 3.0]), 160, 120)
    assert held is not None
    grey = np.full((HEIGHT, WIDTH, 3), 120, np.uint8)
    for name, view in views.items():
        assert (render_view(held[name], view, grey, (0, 0, 255)) == 120).all()


def test_views_that_look_apart_are_not_held() -> None:
    views = {"left": make_view((0, 0, 0), yaw=-16), "right": make_view((0.05, 0, 0), yaw=16)}
    point = np.array([0.0, 0.0, 3.0])
    assert all(project_point(view, point) is not None for view in views.values())
    assert stabilize_views(views, point, 160, 120) is None


def seen(dataset: Any, motion: Any, views: Any = None) -> Any:
    return SimpleNamespace(dataset=dataset, motion=motion, known_views=views or {})


def test_the_mover_stays_when_synchronized_and_jumps_when_not(boards: Session, tmp_path: Path) -> None:
    dataset = Dataset(boards)
    views = {name: view for name, view in OpenScene(dataset).views.items() if name != "aside"}
    sweep = render_camera_sweep(seen(dataset, SceneMotion(dataset, 2), views), tmp_path, CompareResult())

    assert sweep is not None
    assert sweep.cameras == ("left", "right")
    assert sweep.stabilized
    assert sweep.ordered_by_position
    assert len(set(sweep.offsets_ms)) == 2
    times_ns = dataset.instants_ns
    assert {times_ns[sweep.instant] + round(ms * 1e6) for ms in sweep.offsets_ms} <= set(times_ns)

    board = np.array([*jump(sweep.instant), 2.2])
    x, y = np.mean([project_point(view, board) for view in views.values()], axis=0).round().astype(int)

    def moved(paths: tuple[str, ...]) -> float:
        """How far the board's middle is from one picture to the next, px."""
        first, second = (cv2.imread(str(tmp_path / path), cv2.IMREAD_GRAYSCALE) for path in paths)
        assert first.shape == (HEIGHT, WIDTH)
        alike = cv2.matchTemplate(second, first[y - 15 : y + 16, x - 15 : x + 16], cv2.TM_CCOEFF_NORMED)
        at = cv2.minMaxLoc(alike)[3]
        return float(np.hypot(at[0] + 15 - x, at[1] + 15 - y))

    assert moved(sweep.synced) < 4
    assert moved(sweep.offset) > 15
    assert sweep.synced_step_px == pytest.approx(moved(sweep.synced), abs=2)
    assert sweep.offset_step_px == pytest.approx(moved(sweep.offset), abs=4)
    shown = cv2.imreadanimation(str(tmp_path / sweep.file))[1]
    assert len(shown.frames) == 2


def test_without_calibration_the_sweep_goes_by_name_and_invents_nothing(
    boards: Session, tmp_path: Path
) -> None:
    dataset = Dataset(boards)
    sweep = render_camera_sweep(seen(dataset, SceneMotion(dataset, 2)), tmp_path, CompareResult())

    assert sweep is not None
    assert sweep.cameras == ("aside", "left", "right")
    assert not sweep.stabilized
    assert not sweep.ordered_by_position
    assert sweep.synced_step_px is None
    kept = cv2.imread(str(tmp_path / sweep.synced[1]))
    assert np.abs(kept.astype(int) - dataset.image("left", sweep.instant)).mean() < 4


def test_the_animation_goes_there_and_back(tmp_path: Path) -> None:
    first = [np.full((60, 80, 3), grey, np.uint8) for grey in (0, 90, 180, 250)]
    path = save_animation(tmp_path, "sweep", (first, first[::-1]), ("synchronized", ["a", "b", "c", "d"]))

    data = (tmp_path / path).read_bytes()
    assert path == "pictures/sweep.gif"
    assert data.startswith(b"GIF89a")
    assert b"NETSCAPE2.0\x03\x01\x00\x00" in data
    frames = cv2.imreadanimation(str(tmp_path / path))[1].frames
    levels = [round(float(frame[200, 200, :3].mean()), -1) for frame in frames]
    assert levels == pytest.approx([0, 90, 180, 250, 180, 90], abs=12)


class Odd:
    """Three cameras of different shapes, one of which lost its middle pictures; nothing moves."""

    cameras = ("a", "b", "c")
    instants_ns = tuple(33_000_000 * k for k in range(5))
    period_ns = 33_000_000

    def instants(self, camera: str) -> tuple[int, ...]:
        return (0, 4) if camera == "c" else (0, 1, 2, 3, 4)

    def size(self, camera: str) -> tuple[int, int]:
        return {"a": (320, 240), "b": (240, 320), "c": (200, 200)}[camera]

    def image(self, camera: str, instant: int) -> np.ndarray:
        assert instant in self.instants(camera)
        width, height = self.size(camera)
        return np.full((height, width, 3), 40 + 40 * instant, np.uint8)

    def worst_residual_us(self) -> None:
        return None


class Still:
    """Nothing moves."""

    dataset = Odd()

    def detected_moving(self, camera: str, instant: int) -> np.ndarray:
        return np.zeros(self.dataset.image(camera, instant).shape[:2], bool)

    moving = detected_moving


def test_cameras_of_other_shapes_and_lost_pictures_still_make_a_sweep(tmp_path: Path) -> None:
    sweep = render_camera_sweep(seen(Odd(), Still()), tmp_path, CompareResult())

    assert sweep is not None
    assert sweep.cameras == ("a", "b", "c")
    assert sweep.instant in (0, 4)
    shapes = {cv2.imread(str(tmp_path / path)).shape for path in (*sweep.synced, *sweep.offset)}
    assert len(shapes) == 1
    assert len(cv2.imreadanimation(str(tmp_path / sweep.file))[1].frames) == 4


def test_a_burst_of_one_instant_has_no_sweep(tmp_path: Path) -> None:
    class Short(Odd):
        instants_ns = (0,)

        def instants(self, camera: str) -> tuple[int, ...]:
            return (0,)

    assert render_camera_sweep(seen(Short(), Still()), tmp_path, CompareResult()) is None
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("cameras", "side"), [(2, LONG_SIDE_PX), (MANY_CAMERAS + 1, SMALLER_PX)])
def test_pictures_keep_the_largest_cameras_shape_at_a_size_for_their_number(cameras: int, side: int) -> None:
    sizes = {f"cam{k}": (1920, 1080) if k else (640, 640) for k in range(cameras)}
    dataset = cast(Any, SimpleNamespace(size=sizes.__getitem__))
    assert _canvas_size(dataset, list(sizes)) == (side, side * 9 // 16)
