"""Depth of a scene that moves, at a small size: right, and confirmed unless the other cameras are late."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from capture_app.common.errors import BadInputError, NotApplicableError
from reconstruction.common.geometry import Array
from reconstruction.depth import live_depth
from reconstruction.depth.live_depth import LiveDepth, LiveMap
from tests.unit.reconstruction.conftest import Scene, make_view

VIEWS = {
    "left": make_view((-0.15, 0.0, 0.0), yaw=2),
    "middle": make_view((0.0, 0.02, 0.0), distortion=(-0.1, 0.02, 0, 0, 0)),
    "right": make_view((0.15, -0.01, 0.0), yaw=-2),
    "away": make_view((0.2, 0.0, 0.0), yaw=170),
}
Look = Callable[[float, float], dict[str, Array]]


@pytest.fixture(scope="module")
def look(scene: Scene) -> Look:
    """Pictures of the cameras that see the boards at a time, the others' so many periods late."""

    def pictures(time: float, late: float) -> dict[str, Array]:
        times = {"left": time + late, "middle": time, "right": time - late}
        greys = {name: scene.look(VIEWS[name], at)[0] for name, at in times.items()}
        return {name: cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR) for name, grey in greys.items()}

    return pictures


def last(live: LiveDepth, look: Look, late: float) -> LiveMap:
    return [live.compute(look(time, late), "middle") for time in (1.0, 2.0, 3.0)][-1]


def test_what_moves_has_depth_where_all_pictures_are_of_one_instant(scene: Scene, look: Look) -> None:
    found = last(LiveDepth(VIEWS, width_px=160), look, late=0.0)
    _, depth, movers = scene.look(VIEWS["middle"], 3.0)
    known = found.depth > 0
    lens = VIEWS["middle"].matrix, VIEWS["middle"].distortion
    small = [
        cv2.resize(
            cv2.undistort(truth.astype(np.float32), *lens), (160, 120), interpolation=cv2.INTER_NEAREST
        )
        for truth in (depth, movers)
    ]
    right, moves = np.abs(found.depth - small[0]) < 0.05 * small[0], small[1] > 0.5
    assert right[known].mean() > 0.88
    assert known.mean() > 0.7
    assert right[moves].mean() > 0.78
    assert found.moving[moves].mean() > 0.3
    assert found.moving[~moves].mean() < 0.05
    assert found.moving_confirmed > 0.85


def test_what_moves_has_none_where_the_others_are_late(look: Look) -> None:
    found = last(LiveDepth(VIEWS, width_px=160), look, late=0.7)
    assert found.moving_confirmed < 0.5
    assert (found.depth > 0).mean() > 0.6, "what stands still has depth all the same"


def test_a_camera_that_shows_something_else_denies_depth(look: Look) -> None:
    images = look(1.0, 0.0)
    live = LiveDepth(VIEWS, width_px=160)
    found = live.compute(images, "middle")
    noise = np.random.default_rng(5).integers(0, 255, images["right"].shape, np.uint8)
    other = live.compute(images | {"right": noise}, "middle")
    assert (other.depth > 0).mean() < 0.2 * (found.depth > 0).mean()


def test_only_what_two_others_see_can_be_denied(look: Look) -> None:
    images = look(1.0, 0.0)
    live = LiveDepth(VIEWS, width_px=160)
    seen = {name: live._calibrate(name, image) for name, image in (images | {"away": images["left"]}).items()}
    level = np.full(seen["middle"].grey.shape, 1 / 4, np.float32)
    for second, fraction in (("right", 0.85), ("away", 0.0)):
        _, able = live._confirm(seen["middle"], [seen["left"], seen[second]], level)
        assert able.mean() == pytest.approx(fraction, abs=0.14)


def test_what_gets_brighter_as_a_whole_does_not_move(look: Look) -> None:
    images = {name: image // 2 for name, image in look(1.0, 0.0).items()}
    live = LiveDepth(VIEWS, width_px=160)
    for brighter in (0, 25, 50):
        found = live.compute({name: image + np.uint8(brighter) for name, image in images.items()}, "middle")
    assert found.moving.mean() < 0.02


def test_nothing_moves_in_a_still_scene(look: Look, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_depth, "LOOK_S", 0.0)
    live = LiveDepth(VIEWS, width_px=160)
    images = look(1.0, 0.0)
    found = [live.compute(images, "left") for _ in range(3)]
    assert [one.moving_confirmed for one in found] == [None] * 3
    assert found[-1].moving.sum() == 0
    assert (found[-1].depth > 0).mean() > 0.6


def test_a_camera_without_depth_says_why(look: Look) -> None:
    live = LiveDepth(VIEWS, width_px=160)
    images = look(1.0, 0.0)
    with pytest.raises(BadInputError, match="door is not in the calibration"):
        live.compute(images, "door")
    with pytest.raises(BadInputError, match="away gives no picture"):
        live.compute(images, "away")
    with pytest.raises(NotApplicableError, match="no other camera sees what away sees"):
        live.compute({**images, "away": images["left"][::-1]}, "away")
    with pytest.raises(NotApplicableError, match="no camera beside left gives a picture"):
        LiveDepth(VIEWS, width_px=160).compute({"left": images["left"]}, "left")
