"""Which solutions structure from motion tries, and what is said of the one it takes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.common.errors import BadInputError, NotApplicableError
from capture_app.session.format.calibration import Calibration
from reconstruction.common.memory import limited_memory
from reconstruction.common.native_libraries import ForeignError
from reconstruction.scene.calibration import structure_from_motion
from reconstruction.scene.calibration.consistency import GIVEN_ERROR
from reconstruction.scene.calibration.structure_from_motion import (
    GIVE_LENSES,
    calibrate_from_images,
    guess_calibration,
    likely_focal_lengths,
)
from tests.unit.reconstruction.conftest import make_view

LENS = make_view((0, 0, 0)).to_calibration()


def rig(*names: str) -> Any:
    """What moves before these cameras: nothing."""
    dataset = SimpleNamespace(
        name="rig", cameras=names, size=lambda name: (320, 240), instants=lambda name: (0, 1)
    )
    return SimpleNamespace(dataset=dataset, background=lambda name: np.full((240, 320), ord(name), np.uint8))


class Solver:
    """Solutions of three cameras' images; the focal lengths with which each is sought."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **focal_px: float) -> None:
        self.asked = list[tuple[Mapping[str, float], str, bool]]()
        self.pictures = dict[str, int]()
        self.odd, self.errors, self.fails_alone = False, [0.01], False
        monkeypatch.setattr(structure_from_motion, "load_pycolmap", lambda *_, **__: "pycolmap")
        monkeypatch.setattr(structure_from_motion, "likely_focal_lengths", lambda *_, **__: focal_px)
        monkeypatch.setattr(structure_from_motion, "_found", self._found)
        monkeypatch.setattr(structure_from_motion, "refuse_odd_lenses", self._refuse)

    def _found(
        self,
        pycolmap: Any,
        dataset: Any,
        cameras: Sequence[str],
        root: Path,
        focal_px: Any,
        model: str,
        *,
        held: bool,
    ) -> tuple[Calibration, list[float]]:
        assert pycolmap == "pycolmap"
        self.asked.append((focal_px, model, held))
        for name in cameras:
            image = cv2.imread(str(root / "images" / name / "background.png"), cv2.IMREAD_GRAYSCALE)
            self.pictures[name] = int(np.asarray(image)[0, 0])
        if self.fails_alone and not focal_px:
            raise NotApplicableError("none can be found", hint="more texture")
        source = "held" if held else "given" if focal_px else "alone"
        return Calibration(cameras=dict.fromkeys(cameras, LENS), source=source), self.errors

    def _refuse(self, found: Any, focal_px: Any) -> None:
        assert {*found} == {*"abc"}
        if self.odd:
            raise NotApplicableError("a would see 150 degrees wide", hint="a board")


def test_three_cameras_tell_their_lenses_from_their_backgrounds(monkeypatch: pytest.MonkeyPatch) -> None:
    solver = Solver(monkeypatch)
    assert calibrate_from_images(rig("a", "b", "c")).source == "alone"
    assert solver.asked == [({}, "SIMPLE_RADIAL", False)]
    assert solver.pictures == {name: ord(name) for name in "abc"}
    assert calibrate_from_images(rig("a", "b", "c"), fisheyes=True).source == "alone"
    assert solver.asked[1][1] == "RADIAL_FISHEYE"
    # A lens that cannot be is refused where no likely one is known of all.
    solver.odd = True
    with pytest.raises(NotApplicableError, match="150 degrees"):
        calibrate_from_images(rig("a", "b", "c"))


def test_odd_lenses_are_sought_without_what_was_given_and_else_held(monkeypatch: pytest.MonkeyPatch) -> None:
    given = dict.fromkeys("abc", LENS.fx)
    solver = Solver(monkeypatch, **given)
    assert calibrate_from_images(rig("a", "b", "c")).source == "given"
    solver.odd = True
    assert calibrate_from_images(rig("a", "b", "c")).source == "alone"
    assert [(focal, held) for focal, _, held in solver.asked[1:]] == [(given, False), ({}, False)]
    for errors, fails in (([0.5], False), ([], False), ([0.01], True)):
        solver.errors, solver.fails_alone, solver.asked = errors, fails, []
        assert calibrate_from_images(rig("a", "b", "c")).source == "held"
        assert [(focal, held) for focal, _, held in solver.asked] == [
            (given, False),
            ({}, False),
            (given, True),
        ]


def test_two_cameras_lenses_are_held_and_one_camera_is_no_rig(monkeypatch: pytest.MonkeyPatch) -> None:
    solver = Solver(monkeypatch, a=300.0, b=300.0)
    assert calibrate_from_images(rig("a", "b")).source == "held"
    assert len(solver.asked) == 1
    with pytest.raises(NotApplicableError, match="fewer than two cameras with an image"):
        calibrate_from_images(rig("a"))
    without = rig("a", "b")
    without.dataset.instants = lambda name: (0,) if name == "a" else ()
    with pytest.raises(NotApplicableError, match="fewer than two cameras with an image"):
        calibrate_from_images(without)
    Solver(monkeypatch, a=300.0)
    with pytest.raises(NotApplicableError, match="do not determine their lenses"):
        calibrate_from_images(rig("a", "b"))


def test_a_guess_is_said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    Solver(monkeypatch)
    assert guess_calibration(rig("a", "b", "c")).source == "alone"
    assert "rig has no calibration; this one was found: alone" in capsys.readouterr().err


def placed(name: str) -> Any:
    """An image of COLMAP's of a camera at the origin, whose first pixel's centre is at a half."""
    camera = SimpleNamespace(params=(300.0, 160.0, 120.0, 0.1), model=SimpleNamespace(name="SIMPLE_RADIAL"))
    pose = SimpleNamespace(matrix=lambda: np.column_stack([np.eye(3), np.full(3, ord(name))]))
    return SimpleNamespace(
        name=f"{name}/background.png", has_pose=True, camera=camera, cam_from_world=lambda: pose
    )


def model_of(*names: str) -> Any:
    lost = SimpleNamespace(name="z/background.png", has_pose=False)
    return SimpleNamespace(
        images={k: placed(name) for k, name in enumerate(names)} | {99: lost},
        num_points3D=lambda: 640,
        compute_mean_reprojection_error=lambda: 0.42,
    )


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What COLMAP answers by the first camera's focal length, and whether the points lie flat."""
    answers: dict[str, Any] = {
        "asked": [],
        "flat": False,
        "errors": [0.01, 0.02],
        "default": model_of("a", "b"),
    }

    def solve(pycolmap: Any, work: Path, focal_px: Any, extraction: Any, model: str, *, held: bool) -> Any:
        assert work.is_dir()
        assert extraction == [(320, 240)] * 3
        first = focal_px.get("a")
        answers["asked"].append((first, held))
        return answers.get(str(first), answers["default"])

    monkeypatch.setattr(structure_from_motion, "_solve", solve)
    monkeypatch.setattr(structure_from_motion, "_extraction", lambda pycolmap, sizes: sizes)
    monkeypatch.setattr(structure_from_motion, "lie_flat", lambda rec: answers["flat"])
    monkeypatch.setattr(structure_from_motion, "focal_errors", lambda pycolmap, rec: answers["errors"])
    return answers


def found(tmp_path: Path, *, held: bool = False, **focal_px: float) -> tuple[Calibration, Any]:
    calibration, errors = structure_from_motion._found(
        SimpleNamespace(__version__="9.9"),
        rig("a", "b", "c").dataset,
        ("a", "b", "c"),
        tmp_path,
        focal_px,
        "SIMPLE_RADIAL",
        held=held,
    )
    return calibration, errors


def test_a_solution_says_how_many_cameras_and_how_well_lenses_are_known(
    tmp_path: Path, solved: dict[str, Any]
) -> None:
    calibration, errors = found(tmp_path)
    assert (calibration.unit, errors) == ("arbitrary", [0.01, 0.02])
    assert calibration.source.startswith("COLMAP 9.9, 2 of 3 cameras from 640 still points, 0.42 px, ")
    assert calibration.source.endswith("; not placed: c")
    assert [*calibration.cameras] == ["a", "b"]
    camera = calibration.cameras["a"]
    assert (camera.width, camera.height, camera.fx, camera.cx, camera.cy) == (320, 240, 300, 159.5, 119.5)
    assert camera.translation == (97, 97, 97)
    assert camera.distortion[:2] == (0.1, 0)
    lenses = calibration.known_lenses
    assert lenses.level == "well" or lenses.why
    # Not all cameras' lenses were given, so that it may be a guess.
    solved["errors"] = []
    assert "too few points" in found(tmp_path)[0].known_lenses.why
    assert found(tmp_path)[0].known_lenses.is_guess
    solved["flat"] = True
    calibration, errors = found(tmp_path)
    assert (errors, "these points lie in one plane" in calibration.source) == ([], True)
    calibration, errors = found(tmp_path, held=True, a=1.0, b=1.0, c=1.0)
    assert errors == []
    assert "do not confirm the field of view that was given" in calibration.source
    assert not calibration.known_lenses.is_guess


def test_lenses_near_given_ones_are_sought_from_two_more_starts(
    tmp_path: Path, solved: dict[str, Any]
) -> None:
    solved["100.0"] = None
    found(tmp_path, a=100.0, b=100.0, c=100.0)
    starts = [focal for focal, _ in solved["asked"]]
    assert starts == [100.0, pytest.approx(100 * (1 - GIVEN_ERROR))]
    solved["asked"], solved["default"] = [], None
    with pytest.raises(NotApplicableError, match="none can be found") as refused:
        found(tmp_path, a=100.0, b=100.0, c=100.0)
    assert [focal for focal, _ in solved["asked"]] == [100.0, pytest.approx(96), pytest.approx(104)]
    assert GIVE_LENSES not in (refused.value.hint or "")
    # Held ones have one start, and those of which nothing is known.
    solved["asked"] = []
    with pytest.raises(NotApplicableError, match="none can be found"):
        found(tmp_path, held=True, a=100.0)
    with pytest.raises(NotApplicableError, match="none can be found") as refused:
        found(tmp_path)
    assert solved["asked"] == [(100.0, True), (None, False)]
    assert GIVE_LENSES in (refused.value.hint or "")
    solved["default"] = model_of("a")
    with pytest.raises(NotApplicableError, match="only one camera could be placed"):
        found(tmp_path)


def test_a_field_of_view_gives_focal_lengths() -> None:
    dataset = rig("a", "b").dataset
    assert likely_focal_lengths(dataset, 90.0) == {"a": pytest.approx(160), "b": pytest.approx(160)}
    assert likely_focal_lengths(dataset, 180.0, fisheyes=True)["a"] == pytest.approx(320 / np.pi)
    with pytest.raises(BadInputError, match="no perspective lens sees 179 degrees"):
        likely_focal_lengths(dataset, 179.0)
    with pytest.raises(BadInputError, match="only with their field of view"):
        likely_focal_lengths(dataset, fisheyes=True)


class Colmap:
    """What is asked of COLMAP, in order; `fails` names calls that raise."""

    def __init__(self, *, fails: Sequence[str] = (), placed: Mapping[str, int] = {}) -> None:
        self.calls, self._fails, self._placed = list[str](), fails, placed
        self.focal = None

    def __getattr__(self, name: str) -> Any:
        if name[0].isupper():
            return lambda **options: SimpleNamespace(
                ransac=SimpleNamespace(),
                mapper=SimpleNamespace(bundle_adjustment=SimpleNamespace()),
                **options,
            )

        def call(*given: Any, **_: Any) -> Any:
            self.calls.append(name)
            if name in self._fails:
                raise ForeignError("it failed")
            if name.endswith("mapping"):
                self.options = given[3]
                assert Path(given[2]).is_dir()
                counts = {0: self._placed.get(name, 3), 1: 1}
                return {k: SimpleNamespace(num_reg_images=lambda n=n: n, by=name) for k, n in counts.items()}
            return None

        return call

    CameraMode = SimpleNamespace(PER_FOLDER=0)
    Device = SimpleNamespace(cpu=0)


def solve(colmap: Colmap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, held: bool = False) -> Any:
    monkeypatch.setattr(structure_from_motion, "_set_focal_lengths", lambda *_: None)
    work = tmp_path / f"work{len([*tmp_path.iterdir()])}"
    work.mkdir()
    return structure_from_motion._solve(colmap, work, {}, None, "SIMPLE_RADIAL", held=held)


def test_a_likely_focal_length_is_that_of_its_own_camera() -> None:
    cameras = [SimpleNamespace(camera_id=k, focal_length=9.0, has_prior_focal_length=False) for k in (1, 2)]
    images = [SimpleNamespace(camera_id=k, name=f"{name}/background.png") for k, name in enumerate("ab", 1)]
    written = list[Any]()
    database = SimpleNamespace(
        read_all_cameras=lambda: cameras,
        read_all_images=lambda: images,
        update_camera=written.append,
        close=lambda: None,
    )
    colmap = SimpleNamespace(Database=SimpleNamespace(open=lambda path: database))
    structure_from_motion._set_focal_lengths(colmap, Path("database.db"), {"b": 480.0})
    assert written == [SimpleNamespace(camera_id=2, focal_length=480.0, has_prior_focal_length=True)]


def test_global_mapping_is_followed_by_incremental_where_it_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    matched = ["set_random_seed", "extract_features", "match_exhaustive"]
    colmap = Colmap()
    best = solve(colmap, tmp_path, monkeypatch)
    assert (best.by, best.num_reg_images()) == ("global_mapping", 3)
    assert colmap.calls == [*matched, "calibrate_view_graph", "global_mapping"]
    assert colmap.options.mapper.bundle_adjustment.refine_focal_length
    held = Colmap()
    assert solve(held, tmp_path, monkeypatch, held=True).by == "global_mapping"
    assert held.calls == [*matched, "global_mapping"]
    assert not held.options.mapper.bundle_adjustment.refine_focal_length
    for failing in (Colmap(fails=["global_mapping"]), Colmap(placed={"global_mapping": 1})):
        assert solve(failing, tmp_path, monkeypatch).by == "incremental_mapping"
        assert failing.options.ba_refine_focal_length
        assert failing.options.mapper.init_min_tri_angle == 4.0
    both = Colmap(fails=["calibrate_view_graph", "incremental_mapping"])
    assert solve(both, tmp_path, monkeypatch) is None


def test_features_are_of_images_that_fit_the_memory_and_come_in_one_order() -> None:
    def extraction(*sizes: tuple[int, int]) -> Any:
        options = SimpleNamespace(eff_max_image_size=lambda: 3200, sift=SimpleNamespace())
        colmap = SimpleNamespace(FeatureExtractionOptions=lambda: options)
        return structure_from_motion._extraction(colmap, sizes)

    plain = extraction((640, 480))
    assert (plain.max_image_size, plain.num_threads, plain.sift.peak_threshold) == (3200, 1, 0.004)
    with limited_memory(200 << 20):
        assert extraction((640, 480)).max_image_size == 3200
        small = extraction((640, 480), (1920, 1080)).max_image_size
        # 220 bytes a pixel, in 60 % of the memory; larger images are reduced to COLMAP's limit before.
        assert 220 * small**2 * 9 / 16 <= 0.6 * (200 << 20)
        assert 320 < small < 1920
        assert extraction((19200, 10800)).max_image_size == pytest.approx(small, rel=0.4)
