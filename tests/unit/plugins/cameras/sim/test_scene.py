import cv2
import numpy as np
import pytest

from capture_app.board.boards import DEFAULT_BOARD
from capture_app.board.coverage import CoverageCount
from capture_app.common.errors import BadInputError
from capture_app.plugins.cameras.sim.rendering.layers import look_at
from capture_app.plugins.cameras.sim.rendering.scene import SCENES, Scene, load
from capture_app.plugins.cameras.sim.scenes import moving_bodies
from capture_app.plugins.cameras.sim.scenes.stages import DEFINITIONS
from capture_app.protocol.orders import FLAT_SCENES, VIEWS

SCALE = 0.25
START_NS = 1_000_000_000_000_000
EXPOSURE_NS = 8_000_000
ROW_NS = 40_000  # a quarter of the rows: as long a readout as 10 us of a full picture


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load("studio", scale=SCALE)


def picture(
    scene: Scene, view: str = "cam00", start_ns: int = START_NS, seed: int = 1, **times: int
) -> np.ndarray:
    return scene.render(
        view, start_ns, times.get("exposure_ns", EXPOSURE_NS), times.get("row_time_ns", ROW_NS), seed=seed
    )


def around(mask: np.ndarray, pixels: int) -> np.ndarray:
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    return cv2.dilate(mask.astype(np.uint8), cross, iterations=pixels).astype(bool)


def test_an_unknown_scene_names_what_there_is() -> None:
    with pytest.raises(BadInputError, match="studio"):
        load("moon")


def test_a_leader_starts_cameras_for_the_views_there_are() -> None:
    assert set(SCENES) == set(DEFINITIONS) == set(VIEWS) - set(FLAT_SCENES)
    for name, definition in DEFINITIONS.items():
        assert VIEWS[name] == tuple(definition.cameras)


def test_scene_is_built_once(scene: Scene) -> None:
    assert load("studio", scale=SCALE) is scene


def test_pictures_have_the_views_size_and_use_the_tonal_range(scene: Scene) -> None:
    shot = picture(scene)
    assert shot.shape == (120, 160, 3)
    assert shot.dtype == np.uint8
    assert np.percentile(shot, 1) < 40
    assert np.percentile(shot, 99) > 200
    assert np.mean(shot == 255) < 0.03


def test_a_draft_shows_the_same_in_small(scene: Scene) -> None:
    draft = scene.draft(0.5)
    assert scene.draft(0.5) is draft
    full = scene.render("cam01", START_NS, 4_000_000, ROW_NS, seed=1)
    small = draft.render("cam01", START_NS, 4_000_000, 2 * ROW_NS, seed=1)
    assert small.shape == (60, 80, 3)
    # Single pixels differ: of one sample each, textures are coarser.
    blocks = full.reshape(6, 20, 8, 20, 3).mean((1, 3)), small.reshape(6, 10, 8, 10, 3).mean((1, 3))
    assert np.abs(blocks[0] - blocks[1]).mean() < 0.03 * 255
    assert np.corrcoef(blocks[0].ravel(), blocks[1].ravel())[0, 1] > 0.98


def test_seed_changes_only_the_noise(scene: Scene) -> None:
    difference = picture(scene, seed=1).astype(int) - picture(scene, seed=2)
    assert 0.5 < difference.std() < 8
    assert abs(difference.mean()) < 0.1


def test_rolling_shutter_displaces_moving_objects_only(scene: Scene) -> None:
    later_ns = 80_000
    depth, _, movers = scene.ground_truth("cam00", START_NS, EXPOSURE_NS, 0)
    rolled_depth, _, rolled = scene.ground_truth("cam00", START_NS, EXPOSURE_NS, later_ns)
    still = ~(movers | rolled)
    assert np.array_equal(depth[still], rolled_depth[still])
    # The first row is exposed at the same time, the last ones 9 ms later.
    changed = movers ^ rolled
    assert changed.mean() > 0.002
    flash, rolling = picture(scene, row_time_ns=0).astype(int), picture(scene, row_time_ns=later_ns)
    difference = np.abs(flash - rolling).max(axis=2)
    untouched = ~around(movers | rolled, 12)
    assert difference[changed].mean() > 20
    # Shadows on the wall and the rug move too, so a few still pixels change.
    assert np.mean(difference[untouched] > 6) < 0.05


def test_row_sees_the_scene_at_its_own_time(scene: Scene) -> None:
    row = 60
    depth, things, _ = scene.ground_truth("cam00", START_NS, 0, ROW_NS)
    at_row, things_at_row, _ = scene.ground_truth("cam00", START_NS + row * ROW_NS, 0, 0)
    assert np.array_equal(things[row], things_at_row[row])
    assert np.allclose(depth[row], at_row[row], atol=1e-4)
    assert not np.array_equal(things, things_at_row)


def test_depth_agrees_with_the_calibration(scene: Scene) -> None:
    cameras = scene.calibration().cameras
    assert set(cameras) == set(scene.views)
    a, b = cameras["cam00"], cameras["cam03"]
    depth_a, _, movers_a = scene.ground_truth("cam00", START_NS, EXPOSURE_NS, ROW_NS)
    depth_b, things_b, movers_b = scene.ground_truth("cam03", START_NS, EXPOSURE_NS, ROW_NS)
    floor = scene.things.index("floor")
    rotation_a, rotation_b = np.array(a.rotation), np.array(b.rotation)
    checked = 0
    for row in range(4, a.height, 3):
        for column in range(4, a.width, 3):
            if movers_a[row, column] or depth_a[row, column] == 0:
                continue
            z = depth_a[row, column]
            seen = np.array([(column - a.cx) / a.fx * z, (row - a.cy) / a.fy * z, z])
            world = rotation_a.T @ (seen - np.array(a.translation))
            x, y, z = rotation_b @ world + np.array(b.translation)
            u, v = b.fx * x / z + b.cx, b.fy * y / z + b.cy
            left, top = int(np.floor(u)), int(np.floor(v))
            if not (0 <= left < b.width - 1 and 0 <= top < b.height - 1):
                continue
            patch = np.s_[top : top + 2, left : left + 2]
            if movers_b[patch].any() or (things_b[patch] != floor).any():
                continue
            # Planes are linear in inverse depth.
            inverse = 1 / depth_b[patch].astype(np.float64)
            upper = inverse[0, 0] * (1 - u + left) + inverse[0, 1] * (u - left)
            lower = inverse[1, 0] * (1 - u + left) + inverse[1, 1] * (u - left)
            there = 1 / (upper * (1 - v + top) + lower * (v - top))
            if abs(world[1] - 1.0) < 1e-4:
                assert there == pytest.approx(z, rel=1e-3)
                checked += 1
    assert checked > 30


def test_moving_regions_cover_the_change_between_two_instants(scene: Scene) -> None:
    depth, _, movers = scene.ground_truth("cam00", START_NS, EXPOSURE_NS, ROW_NS)
    later_depth, _, later = scene.ground_truth("cam00", START_NS + 66_000_000, EXPOSURE_NS, ROW_NS)
    changed = depth != later_depth
    assert changed.any()
    assert not np.any(changed & ~(movers | later))


def test_objects_are_named_and_moving_ones_marked(scene: Scene) -> None:
    _, things, movers = scene.ground_truth("cam04", START_NS, EXPOSURE_NS, ROW_NS)
    names = [scene.things[number] for number in np.unique(things)]
    assert {"figure", "pinwheel", "floor", "walls", "rug", "shelf"} <= set(names)
    moving = [*scene._thing_of.values()]
    assert np.array_equal(np.isin(things, moving), movers)


@pytest.mark.parametrize("step", range(10))
def test_moving_objects_are_in_every_view_at_any_time(scene: Scene, step: int) -> None:
    start = START_NS + step * 9_777_777_777
    shares = {v: scene.ground_truth(v, start, EXPOSURE_NS, ROW_NS)[2].mean() for v in scene.views}
    assert min(shares.values()) > 0.05


def test_all_is_far_enough_for_a_panorama(scene: Scene) -> None:
    for view in ("cam02", "cam03"):
        assert scene.ground_truth(view, START_NS, EXPOSURE_NS, ROW_NS)[0].min() >= 1.8


@pytest.mark.parametrize("time_ns", [0, -1, 2**63 - 10**9, -(2**63), moving_bodies.CYCLE_NS - 1])
def test_motion_goes_on_for_ever(time_ns: int) -> None:
    seconds = moving_bodies.cycle_seconds(np.array([time_ns, time_ns + 1], np.int64))
    for pose in (moving_bodies.jumping_child(seconds) | moving_bodies.turning_wheel(seconds)).values():
        assert np.allclose(np.linalg.det(pose.rotation), 1)
        # Nothing moves faster than 10 m/s or turns faster than 40 rad/s: no jump where the cycle ends.
        assert np.ptp(pose.translation, axis=0).max() < 1e-8
        assert np.ptp(pose.rotation, axis=0).max() < 4e-8


def test_no_part_stands_still_for_66_ms() -> None:
    start = np.arange(0, moving_bodies.HOP_S * 6, 0.013)
    now, later = moving_bodies.jumping_child(start), moving_bodies.jumping_child(start + 0.066)
    torso = np.linalg.norm((later["torso"].translation - now["torso"].translation)[:, :2], axis=1)
    # 3 mm sideways look like 2 % of the depth to the stereo pair, 0.16 m apart.
    assert torso.min() > 0.015


def test_views_are_those_of_the_calibration_at_full_size() -> None:
    calibration = Scene.calibration(load("studio", scale=SCALE))
    first, second = (np.array(calibration.cameras[n].rotation) for n in ("cam02", "cam03"))
    turned = np.degrees(np.arccos(first[2] @ second[2]))
    assert 24 < turned < 30
    centres = [
        -np.array(c.rotation).T @ np.array(c.translation)
        for c in (calibration.cameras[n] for n in calibration.cameras)
    ]
    assert np.ptp(centres, axis=0)[0] <= 0.7
    assert np.linalg.norm(centres[0] - centres[1]) == pytest.approx(0.16, abs=0.01)


def test_the_board_is_held_everywhere_before_every_camera() -> None:
    seconds = np.arange(0, 60, 1.3)
    held = DEFINITIONS["board"].poses(seconds)["sheet"]
    views = {
        name: look_at(name, *DEFINITIONS["board"].cameras[name])
        for name in ("cam00", "cam01", "cam04", "cam05", "cam06")
    }
    count = CoverageCount(DEFAULT_BOARD, dict.fromkeys(views, (640, 480)))
    middle = DEFAULT_BOARD.places.mean(0)
    for turned, moved in zip(held.rotation, held.translation, strict=True):
        points = (DEFAULT_BOARD.places - middle) @ turned.T + moved
        seen = {}
        for name, view in views.items():
            pixels = view.project(points)[:, :2]
            inside = ((pixels > 0) & (pixels < (640, 480))).all(axis=1)
            seen[name] = {int(number): pixels[number] for number in np.flatnonzero(inside)}
        count.add(seen)
    assert count.coverage().missing == ()


def test_walkers_keep_their_feet_on_the_floor_and_repeat_themselves() -> None:
    seconds = np.arange(0, moving_bodies.LAP_S, 0.01)
    walked = moving_bodies.walking_child(seconds, ahead=0.25, prefix="")
    again = moving_bodies.walking_child(seconds + moving_bodies.LAP_S, ahead=0.25, prefix="")
    ankles = np.stack(
        [walked[f"{side}_shin"].point(0, moving_bodies.SHIN_M, 0) for side in ("left", "right")]
    )
    height = moving_bodies.FLOOR_Y - moving_bodies.ANKLE_M - ankles[:, :, 1]
    assert np.abs(height.min(axis=0)).max() < 0.01  # one foot always stands
    assert 0.03 < height.max() < 0.3
    for name, pose in walked.items():
        assert np.allclose(pose.translation, again[name].translation, atol=1e-6)
    # It looks where it goes.
    way = np.diff(walked["hips"].translation, axis=0)
    ahead = walked["hips"].rotation[:-1] @ np.array([0.0, 0.0, -1.0])
    cosine = (way[:, [0, 2]] * ahead[:, [0, 2]]).sum(1) / np.linalg.norm(way[:, [0, 2]], axis=1)
    assert cosine.min() > 0.98
