"""Cameras that were moved, masks of what moves, and pairs for a panorama."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import msgspec
import numpy as np
import pytest

from capture_app.common.errors import BadInputError, NotApplicableError
from capture_app.console.terminal import Progress
from capture_app.session.format.calibration import Calibration, LensKnowledge
from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import Array
from reconstruction.scene import moving_pixels
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.moving_pixels import SceneMotion, find_shifts, measure_camera_motion, write_masks
from reconstruction.scene.pairs import (
    Features,
    PairChoice,
    choose_panorama_pair,
    describe_left_out,
    detect_features,
    fit_homography,
    grid_cells,
)
from reconstruction.scene.scene import Scene as OpenScene
from tests.unit.reconstruction.conftest import PERIOD_NS, VIEWS, Scene, texture, write_session

WALL = np.asarray(cv2.resize(texture(7), (640, 480)))


def film(places: list[float], missing: tuple[int, ...] = ()) -> Any:
    """A camera whose images show a wall moved by so many px, 33 ms apart."""

    def grey(camera: str, k: int) -> Array:
        move = np.array([[1.0, 0, -places[k]], [0, 1, 0]])
        return np.asarray(cv2.warpAffine(WALL, move, (320, 240)))

    return SimpleNamespace(
        instants=lambda camera: tuple(k for k in range(len(places)) if k not in missing),
        instants_ns=tuple(PERIOD_NS * k for k in range(len(places))),
        grey=grey,
    )


@pytest.mark.parametrize("at", [1, 7, 13, 19])
def test_a_bumped_camera_has_a_shift_where_it_was_bumped(at: int) -> None:
    (shift,) = find_shifts(film([0.0] * at + [6.0] * (20 - at)), "a")
    assert shift[:2] == (at - 1, at)
    assert shift[2] == pytest.approx(6, abs=0.2)


def test_a_shift_may_take_a_while_and_be_followed_by_another() -> None:
    places = [0.0] * 4 + [2.0, 4.0] + [6.0] * 9 + [0.0] * 5
    first, second = find_shifts(film(places), "a")
    assert (first[:2], second[:2]) == ((3, 6), (14, 15))
    assert find_shifts(film([0.0] * 20), "a") == []
    assert find_shifts(film([0.0] * 10 + [0.3] * 10), "a") == []
    # Of images that the session lacks, none is named.
    (shift,) = find_shifts(film([0.0] * 10 + [6.0] * 10, missing=(9, 10)), "a")
    assert shift[:2] == (8, 11)


def test_a_cameras_motion_is_measured_over_half_a_second_or_half_the_burst() -> None:
    still, px, ms = measure_camera_motion(film([3.0 * k for k in range(40)]), "a") or (0, 0, 0)
    assert (still, px) == (0, pytest.approx(48, abs=2))
    assert ms == pytest.approx(16 * PERIOD_NS / 1e6)
    still, px, ms = measure_camera_motion(film([0.0] * 5), "a") or (0, 0, 0)
    assert (still, px, ms) == (1, pytest.approx(0, abs=0.1), pytest.approx(2 * PERIOD_NS / 1e6))
    # What is lost over so long may be tracked from an image to the next.
    still, px, ms = measure_camera_motion(film([60.0 * k for k in range(6)]), "a") or (0, 0, 0)
    assert (still, px, ms) == (0, pytest.approx(60, abs=2), pytest.approx(PERIOD_NS / 1e6))
    assert measure_camera_motion(film([0.0]), "a") is None
    assert measure_camera_motion(film([0.0] * 2, missing=(0, 1)), "a") is None
    blank = film([0.0] * 5)
    blank.grey = lambda camera, k: np.full((240, 320), 90, np.uint8)
    assert measure_camera_motion(blank, "a") is None


def test_masks_are_of_the_images_own_size_and_name(boards: Session, tmp_path: Path) -> None:
    dataset = Dataset(boards).fitted(images=1, bytes_per_pixel=1)
    dataset._scale = 0.5
    dataset._read = dataset._image_cache()
    motion, progress = SceneMotion(dataset, 1), Progress(9, silent=True)
    shares = write_masks(motion, tmp_path / "out", progress)
    assert progress.done == len(dataset.cameras)
    for camera in dataset.cameras:
        files = sorted((tmp_path / "out" / camera).iterdir())
        assert [file.name for file in files] == [f"{k:06d}.png" for k in dataset.instants(camera)]
        masks = [np.asarray(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)) for file in files]
        assert {mask.shape for mask in masks} == {(240, 320)}
        assert {*np.unique(masks)} == {0, 255}
        assert shares[camera] == pytest.approx(np.mean([(mask > 0).mean() for mask in masks]), abs=0.002)
        own = motion.widened_moving(camera, 1)
        assert np.array_equal(masks[1][::2, ::2] > 0, own)
    with pytest.raises(BadInputError, match="out"):
        write_masks(motion, tmp_path / "out")


def test_what_moves_is_seen_by_comparing_images(scene: Scene, tmp_path: Path) -> None:
    pair = {name: VIEWS[name] for name in ("left", "right")}
    lonely = Dataset(write_session(tmp_path, scene, pair, instants=2, truth=False, missing={("right", 1)}))
    with pytest.raises(NotApplicableError, match="right has fewer than two images"):
        write_masks(SceneMotion(lonely, 1), tmp_path / "out")
    SceneMotion(lonely, 1).require_several_images(["left"])


def test_scores_use_the_true_motion_and_what_changes(boards: Session) -> None:
    dataset = Dataset(boards)
    motion, camera = SceneMotion(dataset, 1), dataset.cameras[0]
    truth = dataset.ground_truth(camera, 1)
    assert truth is not None
    assert np.array_equal(motion.moving(camera, 1), truth[1])
    detected = motion.detected_moving(camera, 1)
    assert not np.array_equal(detected, truth[1])
    assert np.array_equal(motion.changing(camera, 1), detected | truth[1])
    blind = SceneMotion(dataset, 1)
    blind.dataset = cast("Dataset", Untrue(dataset))
    assert np.array_equal(blind.moving(camera, 1), detected)


class Untrue:
    """A dataset without the truth."""

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset

    def __getattr__(self, name: str) -> Any:
        return (lambda camera, instant: None) if name == "ground_truth" else getattr(self.dataset, name)


def test_an_image_is_compared_with_those_a_step_away_or_with_another(
    boards: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = Dataset(boards)
    camera, compared = dataset.cameras[0], list[int]()

    def detect(image: Array, others: list[Array], background: Array) -> Array:
        compared.extend(
            k for k in range(5) for other in others if np.array_equal(other, dataset.grey(camera, k))
        )
        return np.zeros(image.shape, bool)

    monkeypatch.setattr(moving_pixels, "detect_moving", detect)
    for step, instant, others in ((1, 2, [1, 3]), (2, 2, [0, 4]), (2, 0, [2]), (3, 2, [0]), (9, 0, [1])):
        compared.clear()
        SceneMotion(dataset, step).detected_moving(camera, instant)
        assert compared == others, (step, instant)


def crop(left: int, top: int = 0, size: tuple[int, int] = (320, 240)) -> Features:
    image = np.ascontiguousarray(WALL[top : top + size[1], left : left + size[0]])
    return detect_features(image)


def test_two_images_of_one_plane_overlap_by_their_homography() -> None:
    shelves = {"a": crop(0), "b": crop(160), "c": crop(8)}
    sizes = dict.fromkeys(shelves, (320, 240))
    choice = choose_panorama_pair(shelves, sizes)
    assert choice.cameras in (("a", "b"), ("b", "c"))
    assert choice.why.endswith(" % overlap")
    assert 45 < float(choice.why.split()[0]) < 57
    alike = {name: shelves[name] for name in "ac"}
    assert choose_panorama_pair(alike, sizes) == PairChoice(
        None, "the cameras show too much of the same (98 % or more) for a panorama to show anything new"
    )
    other = detect_features(np.ascontiguousarray(texture(9)[:240, :320]))
    assert choose_panorama_pair({"a": shelves["a"], "d": other}, sizes | {"d": (320, 240)}) == PairChoice(
        None, "no two cameras' pictures can be laid over each other"
    )


def test_the_overlap_is_of_the_first_image_and_needs_enough_matches() -> None:
    rng = np.random.default_rng(2)
    at_a = rng.uniform((0, 0), (320, 240), (60, 2))
    fit = fit_homography(at_a, at_a / 2 + (0, 60), (320, 240), (160, 240))
    assert fit == (pytest.approx(1, abs=0.02), 1)
    fit = fit_homography(at_a, at_a * 2, (320, 240), (320, 240))
    assert fit == (pytest.approx(0.25, abs=0.02), 1)
    half = np.where((np.arange(60) < 30)[:, None], at_a, rng.uniform(0, 240, (60, 2)))
    fit = fit_homography(at_a, half, (320, 240), (320, 240))
    assert fit is not None
    assert fit[1] == pytest.approx(0.5, abs=0.1)
    for few in (0, 3, 5):
        assert fit_homography(at_a[:few], at_a[:few], (320, 240), (320, 240)) is None
    assert fit_homography(at_a, rng.uniform(0, 240, (60, 2)), (320, 240), (320, 240)) is None
    flat = np.column_stack([at_a[:, 0], np.full(60, 50.0)])
    assert fit_homography(at_a, flat, (320, 240), (320, 240)) is None


def test_features_are_of_an_images_own_pixels_and_of_what_is_allowed() -> None:
    whole = detect_features(WALL, 320, 100)
    assert 0 < len(whole.positions) <= 101
    assert whole.positions[:, 0].max() > 330
    left = np.zeros(WALL.shape, bool)
    left[:, :200] = True
    some = detect_features(WALL, 320, 100, allowed=left)
    assert some.positions[:, 0].max() < 202
    near = np.linalg.norm(detect_features(WALL, 640).positions[:, None] - some.positions, axis=2).min(0)
    assert np.median(near) < 1.0
    assert detect_features(WALL, contrast=1e3).descriptors.shape == (0, 128)
    faint = detect_features(WALL, contrast=0.01)
    assert len(faint.positions) > len(detect_features(WALL, contrast=0.08).positions)
    moving = np.zeros(WALL.shape, bool)
    moving[:, 300:] = True
    rest = faint.at_rest(moving)
    assert rest.positions[:, 0].max() < 301


def test_cells_and_pairs_that_are_left_out_are_counted() -> None:
    corners = np.array([[-0.5, -0.5], [319.5, 239.5], [320.5, 240.5]])
    assert len(grid_cells(corners, 320, 240)) == 2
    assert (0, 0) in grid_cells(corners, 320, 240)
    pairs = {f"a,{name}": f"{name} is behind" for name in "bcdefgh"}
    said = describe_left_out(pairs)
    assert said.startswith("a,b: b is behind; a,c: c is behind")
    named = said.count("is behind")
    assert said.endswith(f"; and {7 - named} more pairs")
    assert describe_left_out(dict([*pairs.items()][:named])).count(";") == named - 1


def test_a_scene_says_which_cameras_are_meant(boards: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = OpenScene(Dataset(boards))
    first, second = scene.dataset.cameras[:2]
    assert scene.named_pair((first, second)) == (first, second)
    assert scene.named_pair(None) is None
    with pytest.raises(BadInputError, match=f"{first} cannot be paired with itself"):
        scene.named_pair((first, first))
    with pytest.raises(BadInputError, match="nobody"):
        scene.named_pair((first, "nobody"))
    assert scene.choose_panorama_pair((first, second), 1) == PairChoice((first, second), "asked for")
    assert scene.choose_stereo_pair((first, second), 1).why == "asked for"
    asked: list[Any] = []
    choose: Callable[..., Any] = lambda *of: asked.append(of)  # noqa: E731
    monkeypatch.setattr("reconstruction.scene.scene.choose_panorama_pair", choose)
    scene.choose_panorama_pair(None, 1)
    points, sizes = asked[0]
    assert sizes == dict.fromkeys(scene.dataset.cameras, (320, 240))
    assert points == scene.features.at_rest(1)
    chosen = scene.choose_stereo_pair(None, 1, among=(first, second))
    assert {*(chosen.cameras or ())} <= {first, second}


def test_a_scene_of_another_calibration_or_motion_shares_its_images(boards: Session) -> None:
    scene = OpenScene(Dataset(boards))
    calibration = scene.calibration
    some = {name: calibration.cameras[name] for name in scene.dataset.cameras[:2]}
    other = scene.calibrated(type(calibration)(cameras=some, unit="baseline", source="x"), 0.1)
    assert (other.scale_error, other.unit, {*other.views}) == (0.1, "baseline", {*some})
    assert (scene.scale_error, scene.unit, len(scene.views)) == (0.0, "m", len(scene.dataset.cameras))
    assert other.dataset is scene.dataset
    assert other.features is scene.features
    assert scene.calibrated(None).given is calibration
    moving = scene.moving_over(3)
    assert (moving.motion.step, scene.motion.step) == (3, 1)
    assert moving is scene.moving_over(3)
    assert scene.moving_over(1) is scene
    assert moving.motion.background is scene.motion.background
    assert moving.features.motion is moving.motion
    assert moving.features.of_image is scene.features.of_image
    assert scene.fitted(images=1) is scene
    smaller = other.fitted(images=1, bytes_per_pixel=1e6, fraction=0.9)
    assert smaller.scale_error == 0.1
    assert smaller.given is other.given
    assert smaller.dataset.size("left")[0] < 320


def test_a_scene_without_a_calibration_guesses_one_or_says_why_not(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair = {name: VIEWS[name] for name in ("left", "right")}
    session = write_session(tmp_path, scene, pair, instants=2, truth=False, calibrated=False)
    guesses: list[Any] = []

    def guess(motion: SceneMotion) -> Calibration:
        guesses.append(motion)
        cameras = {name: view.to_calibration() for name, view in pair.items()}
        return Calibration(cameras=cameras, unit="arbitrary", source="a guess")

    monkeypatch.setattr("reconstruction.scene.scene.guess_calibration", guess)
    guessed = OpenScene(Dataset(session))
    assert (guessed.problem, guessed.source, guessed.unit) == ("", "a guess", "arbitrary")
    assert {*guessed.views} == {*guessed.known_views} == {*pair}
    assert (guessed.given, guessed.given_views, len(guesses)) == (None, {}, 1)
    assert guesses[0] is guessed.motion

    def refuse(motion: SceneMotion) -> Calibration:
        raise BadInputError("none can be found")

    monkeypatch.setattr("reconstruction.scene.scene.guess_calibration", refuse)
    unknown = OpenScene(Dataset(session))
    assert unknown.problem == "none can be found"
    assert (unknown.source, unknown.unit, unknown.known_views, unknown.given_views) == ("none", "", {}, {})
    assert unknown.lenses == LensKnowledge()
    assert unknown.choose_stereo_pair(("left", "right"), 0) == PairChoice(
        None, "camera left has no calibration"
    )
    with pytest.raises(BadInputError, match="none can be found"):
        unknown.views  # noqa: B018


@pytest.mark.parametrize(
    ("level", "why", "origin", "confirms", "wrong", "expected"),
    [
        ("not", "a guess", "captured", False, "", ("not", "a guess")),
        ("well", "", "simulated", False, "", ("well", "")),
        ("well", "", "captured", True, "", ("well", "")),
        (
            "well",
            "",
            "captured",
            False,
            "",
            ("roughly", "these pictures do not confirm those that were given"),
        ),
        ("roughly", "off by 3 %", "captured", False, "", ("roughly", "off by 3 %")),
        ("well", "", "simulated", True, "points say 300 px", ("not", "points say 300 px")),
    ],
)
def test_given_lenses_are_known_as_points_at_rest_confirm_them(
    boards: Session,
    monkeypatch: pytest.MonkeyPatch,
    level: Any,
    why: str,
    origin: Any,
    confirms: bool,
    wrong: str,
    expected: tuple[str, str],
) -> None:
    manifest = msgspec.structs.replace(boards.manifest, origin=origin)
    scene = OpenScene(Dataset(Session(boards.folder, manifest)))
    known = msgspec.structs.replace(scene.calibration, lenses=LensKnowledge(level=level, why=why))
    given = scene.calibrated(known)
    check = SimpleNamespace(by_lenses=wrong, confirms_lenses=confirms)
    monkeypatch.setattr(OpenScene, "check", check)
    assert (given.lenses.level, given.lenses.why) == expected
