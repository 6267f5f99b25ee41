"""What is said of a calibration's quality, at each limit, and of what its errors call for."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from reconstruction.common.geometry import View
from reconstruction.scene.calibration import board_calibration
from reconstruction.scene.calibration.board_bundle import CameraErrors
from reconstruction.scene.calibration.board_calibration import lenses_of_recordings
from reconstruction.scene.calibration.consistency import (
    CalibrationQuality,
    check_rig,
    consistent_matches,
    find_mixups,
    find_tracks,
    fit_one_plane,
    judge_calibration,
    lens_knowledge,
    plainly_fits,
    refuse_bad_calibration,
    reprojection_errors,
    triangulate,
    upside_down,
)
from reconstruction.scene.calibration.soundness import refuse_faults, sound_views
from reconstruction.scene.calibration.world import World, in_world, marked_points
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.pairs import MIN_MATCHES, Features
from tests.unit.reconstruction.conftest import make_view
from tests.unit.reconstruction.scene.calibration.test_kept_calibration import calibration

GOOD = CalibrationQuality(
    points=200,
    inlier_share=0.9,
    reprojection_error_px=0.3,
    triangulation_angle_deg=6.0,
    coverage={"a": 0.5, "b": 0.5, "c": 0.4},
)
RIG = {
    name: make_view((x, 0.02 * x, 0), yaw=-4 * x)
    for name, x in zip("abcd", (-0.45, -0.15, 0.15, 0.45), strict=True)
}


@pytest.mark.parametrize(
    ("changes", "cameras", "said"),
    [
        ({}, 3, ""),
        ({}, 6, ""),
        ({}, 7, "not good enough: it covers only 3 of 7 cameras"),
        ({"reprojection_error_px": None}, 3, "cannot be judged: no two of its cameras see enough"),
        ({"triangulation_angle_deg": None}, 3, "cannot be judged: no two of its cameras see enough"),
        ({"points": 3}, 3, "cannot be judged: its cameras share only 3 points"),
        (
            {"inlier_share": 0.2},
            3,
            "not good enough: only 20 % of the shared points have",
        ),
        (
            {"reprojection_error_px": 9.9},
            3,
            "not good enough: the median reprojection error is 9.9 px, above",
        ),
        (
            {"triangulation_angle_deg": 0.1},
            3,
            "not good enough: the median triangulation angle is 0.10",
        ),
    ],
)
def test_a_calibration_is_refused_with_its_first_reason(changes: Any, cameras: int, said: str) -> None:
    quality = msgspec.structs.replace(GOOD, **changes)
    if not said:
        refuse_bad_calibration(quality, cameras, ", or else")
        return
    with pytest.raises(BadInputError, match=f"this calibration (is )?{said}") as refused:
        refuse_bad_calibration(quality, cameras, ", or else")
    assert str(refused.value.hint).endswith(", or else")
    assert ("calibrate again" in str(refused.value.hint)) == ("not good" in said)


def seen(
    count: int = 200, views: dict[str, View] = RIG, noise_px: float = 0.1, seed: int = 1
) -> dict[str, Features]:
    """Features of points that all cameras see, each with a descriptor of its own."""
    rng = np.random.default_rng(1)
    points = rng.uniform((-0.8, -0.6, 2.0), (0.8, 0.6, 5.0), (count, 3))
    descriptors = rng.normal(size=(count, 128)).astype(np.float32)
    return {
        name: Features(
            view.project(points @ view.rotation.T + view.translation) + rng.normal(0, 0.1, (count, 2)),
            descriptors,
            np.ones(count),
        )
        for name, view in RIG.items()
    }


def test_a_calibration_is_judged_by_the_points_of_its_pairs() -> None:
    features = seen()
    pair = features["a"].positions, features["b"].positions
    half = np.where((np.arange(200) < 100)[:, None], pair[1], pair[1][::-1])
    quality = judge_calibration(RIG, {("a", "b"): pair})
    assert (quality.points, quality.inlier_share) == (200, 1)
    assert quality.reprojection_error_px == pytest.approx(0.1, abs=0.05)
    assert quality.triangulation_angle_deg == pytest.approx(5, abs=1.5)
    assert quality.coverage["c"] == quality.coverage["d"] == 0
    assert quality.coverage["a"] > 0.4
    wrong = judge_calibration(RIG, {("a", "b"): (pair[0], half)})
    assert 0.5 <= wrong.inlier_share < 0.62
    assert wrong.coverage["a"] < quality.coverage["a"]
    # Few matches, and cameras without a view, count for nothing.
    nothing = judge_calibration(RIG, {("a", "b"): (pair[0][:5], pair[1][:5]), ("a", "z"): pair})
    assert (nothing.points, nothing.inlier_share, nothing.reprojection_error_px) == (0, 0, None)
    assert nothing.triangulation_angle_deg is None


def test_a_point_is_tracked_through_all_its_pairs_unless_they_contradict() -> None:
    features = seen(60)
    tracks = find_tracks(RIG, features)
    assert len(tracks) == 60
    assert {len(track) for track in tracks} == {4}
    first = min(tracks, key=lambda track: float(np.linalg.norm(track["a"] - features["a"].positions[0])))
    assert first["d"].tolist() == features["d"].positions[0].tolist()
    # In c, two points' descriptors are exchanged: their tracks have two places in it.
    swapped = features["c"].descriptors.copy()
    swapped[[0, 1]] = swapped[[1, 0]]
    mixed = features | {"c": replace(features["c"], descriptors=swapped)}
    left = find_tracks(RIG, mixed)
    assert len([track for track in left if len(track) == 4]) <= 60
    lonely = find_tracks({name: RIG[name] for name in "ab"}, features)
    assert {len(track) for track in lonely} == {2}


def test_exchanged_and_upside_down_cameras_are_named() -> None:
    features = seen()
    assert plainly_fits(RIG, features)
    assert find_mixups(RIG, features) == []
    turned = RIG | {"b": upside_down(RIG["b"])}
    assert not plainly_fits(turned, features)
    assert find_mixups(turned, features) == [
        ("b", "the pictures of b are upside down against the calibration")
    ]
    exchanged = RIG | {"a": RIG["d"], "d": RIG["a"]}
    assert find_mixups(exchanged, features) == [("", "the calibrations of a and d are exchanged")]
    rng = np.random.default_rng(3)
    other = {name: make_view(tuple(rng.normal(0, 1, 3)), yaw=float(rng.normal(0, 15))) for name in RIG}
    ((name, text),) = find_mixups(other, features)
    assert name == ""
    assert text.startswith("it does not fit the pictures: ")
    # A camera without a feature fits no neighbour; a view that it has not is not looked at.
    empty = features | {"d": Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32), np.zeros(0))}
    assert not plainly_fits(RIG, empty)
    assert plainly_fits({name: RIG[name] for name in "abc"}, {name: features[name] for name in "abc"})


def test_a_view_upside_down_sees_the_same_rays_in_turned_pixels() -> None:
    view = make_view((0.1, 0, 0), distortion=(0.1, 0.02, 0.003, -0.002, 0.01))
    turned = upside_down(view)
    at = np.array([[30.0, 40.0], [200.0, 100.0]])
    rays = view.rays(at) @ view.rotation
    again = turned.rays(np.array([319.0, 239.0]) - at) @ turned.rotation
    assert again / again[:, 2:] == pytest.approx(rays / rays[:, 2:], abs=1e-6)
    assert turned.centre == pytest.approx(view.centre)


def test_points_behind_a_camera_and_rays_that_diverge_are_far_off() -> None:
    views = [RIG["a"], RIG["b"]]
    point = np.array([[0.1, 0.1, 3.0]])
    at = np.array([view.project(point @ view.rotation.T + view.translation) for view in views])
    assert triangulate(views, at) == pytest.approx(point, abs=1e-6)
    assert reprojection_errors(views[0], point, at[0]) == pytest.approx([0], abs=1e-6)
    assert reprojection_errors(views[0], -point, at[0]) == 1000
    assert reprojection_errors(views[0], point, at[0] + (1e5, 0)) == 1000
    # Rays that diverge meet far away between them.
    apart = triangulate(views, at + np.array([[[0, 0]], [[200.0, 0]]]))
    assert np.linalg.norm(apart) > 100
    assert apart[0, 2] > 0


def test_errors_call_for_a_board_that_is_tilted_and_reaches_the_corners() -> None:
    errors = CameraErrors(focal_percent=0.5, centre_px=1.25, border_px=2.0, turn_deg=0.1, move_mm=0.0)
    assert str(errors) == (
        "focal length ± 0.5 %, principal point ± 1.2 px, distortion in the corner ± 2 px (95 %)"
    )
    placed = msgspec.structs.replace(errors, move_mm=3.14)
    assert "px, turned ± 0.1 degrees, moved ± 3.1 mm (95 %)" in str(placed)
    assert str(msgspec.structs.replace(errors, focal_percent=1.1)).endswith("(95 %): tilt the board more")
    both = msgspec.structs.replace(errors, focal_percent=1.1, border_px=3.1)
    assert str(both).endswith(": tilt the board more and move it to the corners of the picture")


def recording(name: str, *cameras: str, width: int = 320) -> Any:
    return SimpleNamespace(
        name=name,
        cameras=cameras,
        size=lambda camera: (width, 240),
        instants=lambda camera: (0, 1, 2),
        grey=lambda camera, k: (name, camera, k),
    )


def test_lenses_are_of_all_recordings_in_which_a_camera_sees_the_board(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Detector:
        def __init__(self, board: Any) -> None:
            assert board == "board"

        def detect(self, image: Any) -> Any:
            return None if image[2] == 1 else {0: image}

    monkeypatch.setattr(board_calibration, "BoardDetector", Detector)
    monkeypatch.setattr(board_calibration, "calibrate_lens", lambda *of: of)
    rig: Any = recording("rig", "a", "b")
    board: Any = "board"
    found = lenses_of_recordings(rig, board, [recording("one", "a", "c"), recording("two", "a", "b")])
    assert {*found} == {"a", "b"}
    name, size, given, corners, model = cast("Any", found["a"])
    assert (name, size, given, model.name) == ("a", (320, 240), "board", "AUTO")
    assert corners == [{0: (of, "a", k)} for of in ("one", "two") for k in (0, 2)]
    with pytest.raises(BadInputError, match=r"one was taken by other cameras \(x, y\)") as refused:
        lenses_of_recordings(rig, board, [recording("one", "x", "y")])
    assert refused.value.hint == "give a recording of a, b"
    with pytest.raises(BadInputError, match="b has pictures of 640x240 in one, of 320x240 in rig"):
        lenses_of_recordings(rig, board, [recording("one", "b", width=640)])


def dataset(*cameras: str) -> Dataset:
    sizes: Any = SimpleNamespace(
        name="rig", cameras=cameras, size_on_disk=lambda name: (320, 240), size=lambda name: (160, 120)
    )
    return cast("Dataset", sizes)


def test_sound_views_are_of_the_images_size_without_cameras_that_cannot_be() -> None:
    known = calibration(RIG)
    odd = msgspec.structs.replace(known.cameras["b"], fx=-1.0)
    wide = msgspec.structs.replace(known.cameras["c"], width=400)
    known = msgspec.structs.replace(known, cameras=known.cameras | {"b": odd, "c": wide})
    views, faults = sound_views(dataset("a", "b", "c", "d", "e"), known)
    assert {name: view.width for name, view in views.items()} == {"a": 160, "d": 160}
    assert [name for name, _ in faults] == ["b", "c"]
    assert faults[0][1].startswith("the calibration of camera b cannot be right: ")
    assert faults[1][1] == "camera c is calibrated for 400x240, but its images are 320x240"
    same = calibration(RIG | {"b": RIG["a"]})
    views, faults = sound_views(dataset(*"abcd"), same)
    assert "b" not in views or "a" not in views or faults[0][0] == ""
    assert faults
    with pytest.raises(BadInputError, match=r"of other cameras \(a, b, c, d\) than rig"):
        sound_views(dataset("x", "y"), calibration(RIG))


@pytest.mark.parametrize(
    ("left", "faults", "said"),
    [
        ("ab", [], ""),
        ("", [], ""),
        ("ab", [("c", "c is odd")], ""),
        ("a", [("c", "c is odd")], "c is odd"),
        ("ab", [("", "all are odd")], "all are odd"),
        ("a", [("b", "b is odd"), ("c", "c is")], "the calibration of rig has 2 faults: b is odd; c is"),
    ],
)
def test_faults_that_leave_a_rig_are_borne(left: str, faults: Sequence[Any], said: str) -> None:
    if not said:
        refuse_faults(dataset(*"abc"), [*left], faults)
        return
    with pytest.raises(BadInputError, match=f"^{said}"):
        refuse_faults(dataset(*"abc"), [*left], faults)


def test_marks_are_of_two_cameras_that_stand_apart() -> None:
    ends = np.array([[-0.5, 0.2, 3.4], [0.6, -0.1, 3.0]])
    marks: Any = {
        name: tuple(map(tuple, RIG[name].project(ends @ RIG[name].rotation.T + RIG[name].translation)))
        for name in "ad"
    }
    assert marked_points(RIG, marks) == pytest.approx(ends, abs=1e-4)
    assert marked_points(RIG, {"front": marks["a"], "d": marks["d"]}, {"a": "front"}) == pytest.approx(
        ends, abs=1e-4
    )
    with pytest.raises(BadInputError, match="marked in two cameras"):
        marked_points(RIG, {"a": marks["a"]})
    with pytest.raises(BadInputError, match="nobody"):
        marked_points(RIG, marks | {"nobody": marks["a"]})
    swapped = marks | {"d": marks["d"][::-1]}
    with pytest.raises(BadInputError, match=r"the (first|second) mark in a is \d+ px from"):
        marked_points(RIG, swapped)
    near = replace(RIG["a"], translation=RIG["a"].translation + np.array([1e-3, 0, 0]))
    beside = {
        "a": marks["a"],
        "b": tuple(map(tuple, near.project(ends @ near.rotation.T + near.translation))),
    }
    with pytest.raises(BadInputError, match="a and b see the marks from nearly the same place"):
        marked_points(RIG | {"b": near}, cast("Any", beside))


def test_a_rig_is_moved_turned_and_scaled_into_the_world() -> None:
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    world = World(turn, np.array([1.0, 2, 3]), 2.0)
    moved = in_world(calibration(RIG), world, "m", "by hand")
    assert (moved.unit, moved.source) == ("m", "a board; by hand")
    for name, view in RIG.items():
        now = View.from_calibration(moved.cameras[name], 320, 240)
        assert now.centre == pytest.approx(turn @ (2 * view.centre) + (1, 2, 3))
        assert now.axis == pytest.approx(turn @ view.axis)


def test_lenses_are_known_as_well_as_the_worst_of_them() -> None:
    for errors, level in (([0.01, 0.02], "well"), ([0.02, 0.021], "roughly"), ([0.01, 0.6], "not")):
        knowledge = lens_knowledge(errors)
        assert (knowledge.level, knowledge.is_guess) == (level, False)
    assert lens_knowledge([0.012, 0.035]).why == "off by up to 1.2 to 3.5 % (95 %)"
    unknown = lens_knowledge([], is_guess=True)
    assert (unknown.level, unknown.why, unknown.is_guess) == ("not", "too few points", True)
    assert lens_knowledge([], "nothing moves").why == "nothing moves"


def test_matches_fit_one_geometry_whatever_the_poses_are() -> None:
    features = seen()
    views = RIG["a"], RIG["b"]
    at_a, at_b = features["a"].positions, features["b"].positions
    wrong = np.arange(200) < 60
    mixed = np.where(wrong[:, None], np.random.default_rng(5).permutation(at_b), at_b)
    for pair in (views, (RIG["c"], RIG["d"])):
        found = consistent_matches(pair, at_a, mixed)
        assert found is not None
        assert found[~wrong].mean() > 0.95
        assert found[wrong].mean() < 0.2
    shuffled = np.random.default_rng(5).permutation(at_b)
    assert consistent_matches(views, at_a, shuffled) is None
    assert consistent_matches(views, at_a[:MIN_MATCHES], at_b[:MIN_MATCHES]) is not None
    few = MIN_MATCHES - 1
    assert consistent_matches(views, at_a[:few], at_b[:few]) is None
    # At one place no sample gives a geometry.
    same = np.full((50, 2), 90.0)
    assert consistent_matches(views, same, same) is None


def test_points_in_one_plane_or_too_few_show_no_geometry() -> None:
    features = seen()
    at_a, at_b = features["a"].positions, features["b"].positions
    assert not fit_one_plane(at_a, at_b)
    assert fit_one_plane(at_a[:5], at_b[:5])
    flat = np.column_stack([np.random.default_rng(2).uniform(-1, 1, (200, 2)), np.full(200, 3.0)])
    wall = [view.project(flat @ view.rotation.T + view.translation) for view in (RIG["a"], RIG["b"])]
    assert fit_one_plane(*wall)
    same = np.full((50, 2), 90.0)
    assert fit_one_plane(same, same)


def test_a_rig_is_checked_between_neighbours_that_look_the_same_way() -> None:
    features = seen()
    check = check_rig(RIG, features)
    assert (check.points, check.unchecked, check.holds) == (6 * 200, (), True)
    assert check.error_px == pytest.approx(0.1, abs=0.05)
    assert check.errors_px.keys() == RIG.keys()
    # A camera that has no feature, or looks elsewhere, is not checked.
    some = {name: features[name] for name in "abc"}
    assert check_rig(RIG, some).unchecked == ("d",)
    assert check_rig(RIG, some).points == 3 * 200
    aside = replace(RIG["d"], rotation=make_view((0, 0, 0), yaw=120).rotation)
    assert check_rig(RIG | {"d": aside}, features).unchecked == ("d",)
    nothing = check_rig({}, {})
    assert (nothing.points, nothing.error_px, nothing.holds) == (0, None, True)


def test_a_moved_camera_is_blamed_and_one_of_two_is_not_told_apart() -> None:
    features = seen()
    turn = np.array([[1.0, 0, 0], [0, np.cos(0.03), -np.sin(0.03)], [0, np.sin(0.03), np.cos(0.03)]])
    moved = replace(RIG["b"], rotation=turn @ RIG["b"].rotation, translation=turn @ RIG["b"].translation)
    check = check_rig(RIG | {"b": moved}, features)
    assert [camera.cameras for camera in check.moved] == [("b",)]
    assert check.moved[0].shift_px == pytest.approx(9, abs=1.5)
    assert not check.holds
    pair = {"a": RIG["a"], "b": moved}
    (both,) = check_rig(pair, {name: features[name] for name in pair}).moved
    assert both.cameras == ("a", "b")
