"""Calibration from the images alone, and calibrations that do not fit the images."""

from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.session.format.calibration import Calibration
from capture_app.session.format.lens import Lens, lens_of
from reconstruction.common.geometry import View
from reconstruction.scene.calibration import structure_from_motion
from reconstruction.scene.calibration.soundness import calibrated_views
from reconstruction.scene.calibration.structure_from_motion import (
    calibrate_from_images,
    field_of_view_deg,
    focal_errors,
    lie_flat,
)
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.moving_pixels import SceneMotion
from tests.unit.reconstruction.conftest import (
    VIEWS,
    Board,
    Reconstruct,
    Scene,
    make_view,
    texture,
    write_session,
)


def found_model(pycolmap: Any, seed: int, yaws: tuple[int, ...] = (-24, -8, 8, 24)) -> Any:
    """What COLMAP finds of cameras of 900 px focal length around a heap of points, 0.5 px of noise."""
    rng, model = np.random.default_rng(seed), pycolmap.Reconstruction()
    points = rng.uniform(-1, 1, (150, 3))
    for number, yaw in enumerate(yaws, 1):
        rotation = cv2.Rodrigues(np.radians([3.0 * number, yaw, 0]))[0]
        seen = points @ rotation.T + np.array([0, 0, 4.0])
        at = 900 * seen[:, :2] / seen[:, 2:] + (400, 300) + rng.normal(0, 0.5, (150, 2))
        model.add_camera_with_trivial_rig(
            pycolmap.Camera(
                model="SIMPLE_RADIAL", width=800, height=600, params=[900, 400, 300, 0], camera_id=number
            )
        )
        image = pycolmap.Image(name=f"{number}/0.png", keypoints=at, camera_id=number, image_id=number)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), np.array([0, 0, 4.0]))
        model.add_image_with_trivial_frame(image, pose)
    for place, point in enumerate(points):
        track = pycolmap.Track()
        for number in range(1, len(yaws) + 1):
            track.add_element(number, place)
        model.add_point3D(point, track, np.zeros(3, np.uint8))
    pycolmap.bundle_adjustment(model, pycolmap.BundleAdjustmentOptions(print_summary=False))
    return model


def test_errors_of_focal_lengths_hold() -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no package for this machine")
    misses = []
    for seed in range(8):
        model = found_model(pycolmap, seed)
        errors = focal_errors(pycolmap, model)
        found = [camera.params[0] for _, camera in sorted(model.cameras.items())]
        misses += [(focal / 900 - 1) / error for focal, error in zip(found, errors, strict=True)]
    # The errors are two standard deviations.
    assert 0.3 < np.sqrt(np.mean(np.square(misses))) < 0.7
    assert np.max(np.abs(misses)) < 1.5


@pytest.mark.parametrize("points", [3, 6])
def test_what_leaves_lenses_free_has_no_error(points: int) -> None:
    """Three points fit any lens, and six fit these exactly, with nothing left to tell an error by."""
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no package for this machine")
    model = found_model(pycolmap, 0, (-8, 0, 8))
    for number in list(model.point3D_ids()):
        if number > points:
            model.delete_point3D(number)
    assert focal_errors(pycolmap, model) == []


def test_two_cameras_alone_tell_no_error_of_their_lenses() -> None:
    # Of a real pair, 640 wide, 318 px were found, said to be 10 % off at most, for 1,710.
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no package for this machine")
    assert focal_errors(pycolmap, found_model(pycolmap, 0, (-8, 8))) == []


@pytest.mark.parametrize("depth_m", [0.0, 1.5])
def test_a_wall_before_fisheyes_is_known_to_be_flat(depth_m: float) -> None:
    """Its points bend in the images; the focal lengths that fit them are off by up to a quarter.

    Those of a room are known well: from half of them on, its points end up behind the cameras.
    """
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no package for this machine")
    rng, model = np.random.default_rng(1), pycolmap.Reconstruction()
    points = rng.uniform(-1, 1, (300, 3)) * (4.0, 3.0, depth_m)
    for number, (yaw, x) in enumerate(((-10, -0.6), (4, 0.2), (10, 0.6)), 1):
        rotation = cv2.Rodrigues(np.radians([3.0 * number - 7, yaw, 0]))[0]
        seen = points @ rotation.T + (x, 0, 3.0)
        away = np.hypot(seen[:, 0], seen[:, 1])
        angle = np.arctan2(away, seen[:, 2])
        at = 300 * seen[:, :2] * (angle / away)[:, None] + (400, 300) + rng.normal(0, 0.5, (300, 2))
        lens = {"model": "RADIAL_FISHEYE", "params": [300, 400, 300, 0, 0], "camera_id": number}
        model.add_camera_with_trivial_rig(pycolmap.Camera(width=800, height=600, **lens))
        image = pycolmap.Image(name=f"{number}/0.png", keypoints=at, camera_id=number, image_id=number)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), np.array([x, 0, 3.0]))
        model.add_image_with_trivial_frame(image, pose)
    for place, point in enumerate(points):
        track = pycolmap.Track()
        for number in model.images:
            track.add_element(number, place)
        model.add_point3D(point, track, np.zeros(3, np.uint8))
    assert lie_flat(model) == (depth_m == 0)
    if depth_m:
        assert 0 < max(focal_errors(pycolmap, model)) < 0.02


def test_a_failure_for_want_of_lenses_names_the_option_that_gives_them(
    tmp_path: Path, reconstruct: Reconstruct
) -> None:
    pytest.importorskip("pycolmap", reason="pycolmap has no package for this machine")
    views = {"a": make_view((-0.5, 0.0, 0.0)), "b": make_view((0.5, 0.0, 0.0))}
    blank = Scene([Board((-9, -9, 9, 9), 6.0, np.full_like(texture(1), 90))])
    session = write_session(tmp_path, blank, views, instants=1, calibrated=False, truth=False)
    option = "reconstruct calibrate SESSION --field-of-view DEG"
    assert option in reconstruct("calibrate", session.folder).complaint
    said = reconstruct("calibrate", session.folder, "--field-of-view", 60).err
    assert "none can be found" in said
    assert option not in said


def test_a_calibration_is_scaled_to_the_images() -> None:
    small = make_view((0, 0, 0))
    large = View.from_calibration(small.to_calibration(), small.width * 2, small.height * 2)
    corner = np.array([[-0.5, -0.5], [small.width - 0.5, small.height - 0.5]])
    assert np.allclose(large.rays((corner + 0.5) * 2 - 0.5), small.rays(corner))


@pytest.mark.parametrize(
    ("camera", "width", "problem"),
    [
        ("left", 100, "calibrated for 100x240, but its images are 320x240"),
        ("cam0", 320, r"of other cameras \(cam0\) than boards \(choose another one"),
    ],
)
def test_a_calibration_of_another_shape_or_of_other_cameras_is_refused(
    scene: Scene, tmp_path: Path, camera: str, width: int, problem: str
) -> None:
    session = write_session(tmp_path, scene, {"left": VIEWS["left"]}, instants=1, truth=False)
    known = msgspec.structs.replace(VIEWS["left"].to_calibration(), width=width)
    with pytest.raises(BadInputError, match=problem):
        calibrated_views(Dataset(session), Calibration(cameras={camera: known}))


def test_two_cameras_of_unknown_lenses_are_not_guessed(tmp_path: Path, scene: Scene) -> None:
    pytest.importorskip("pycolmap", reason="pycolmap has no package for this machine")
    two = {name: make_view((x, 0, 0)) for name, x in (("a", -0.1), ("b", 0.1))}
    dataset = Dataset(write_session(tmp_path, scene, two, calibrated=False, truth=False))
    with pytest.raises(BadInputError, match=r"do not determine their lenses .*--field-of-view"):
        calibrate_from_images(SceneMotion(dataset, 1))


def test_a_given_field_of_view_is_checked_against_what_the_pictures_know(
    capsys: pytest.CaptureFixture[str],
) -> None:
    lens = make_view((0, 0, 0)).to_calibration()
    calibration = Calibration(cameras={"a": lens, "b": lens}, source="COLMAP")
    given = {"a": 1.25 * lens.fx, "b": 1.02 * lens.fx}
    found = structure_from_motion._contradicting((calibration, [0.01, 0.01]), given)
    said = f"were given; the pictures say {field_of_view_deg(lens, lens.fx):.1f} ± "
    assert said in found.source
    assert said in capsys.readouterr().err
    for errors, near in (([0.2, 0.2], given), ([0.01, 0.01], {"b": given["b"]}), ([], given)):
        unsure = (calibration, errors)
        assert structure_from_motion._contradicting(unsure, near).source == "COLMAP"


@pytest.mark.parametrize(
    ("model", "half_angle", "bend"),
    [("fisheye", np.radians(80.0), 0.1026), ("fisheye", np.radians(95.0), -0.02), (msgspec.UNSET, 0.9, -0.1)],
)
def test_a_right_field_of_view_is_not_contradicted_by_the_focal_length_alone(
    model: Any, half_angle: float, bend: float
) -> None:
    """A lens whose edges see `half_angle`, by its distortion, not by its focal length."""
    across = half_angle if model == "fisheye" else np.tan(half_angle)
    focal_px = 160 / (across * (1 + bend * across**2))
    lens = msgspec.structs.replace(
        make_view((0, 0, 0)).to_calibration(),
        fx=focal_px,
        fy=focal_px,
        cx=159.5,
        distortion=(bend, *[0.0] * (3 if model == "fisheye" else 4)),
        model=model,
    )
    assert lens_of(lens).field_deg(320) == pytest.approx(np.degrees(2 * half_angle), abs=0.01)
    calibration = Calibration(cameras={"a": lens}, source="COLMAP")
    for given, is_right in ((1.0, True), (1.2, False)):
        found = structure_from_motion._contradicting((calibration, [0.01]), {"a": given * 160 / across})
        assert (found.source == "COLMAP") == is_right
    assert f"the pictures say {np.degrees(2 * half_angle):.1f} ± " in found.source


def test_a_field_ends_where_the_lens_folds() -> None:
    lens = Lens(np.array([[100.0, 0, 159.5], [0, 100.0, 119.5], [0, 0, 1]]), np.array([-0.2, 0, 0, 0]), True)
    assert lens.field_deg(320) == pytest.approx(2 * np.degrees(np.sqrt(1 / 0.6)), abs=0.1)
