"""Parts of depth from all cameras: its options, what they need, COLMAP's workspace, and what is said."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from capture_app.common.errors import SimulshotError
from capture_app.session.exporting.point_cloud import PointCloud, write_ply
from capture_app.session.format.calibration import LensKnowledge
from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import View
from reconstruction.common.matchers import Matcher
from reconstruction.depth.rough_scene import RoughScene
from reconstruction.methods.multiview import colmap_workspace, matcher, multiview_method, sequence
from reconstruction.methods.multiview.fusion import median_of_known
from reconstruction.methods.multiview.input_images import InputImages, undistort_image
from reconstruction.methods.multiview.instant_maps import _why_alone
from reconstruction.methods.multiview.matcher import ChosenMatcher, choose_matcher, match_cameras
from reconstruction.methods.multiview.multiview_method import Multiview
from reconstruction.methods.multiview.result import MultiviewResult, SequenceInstant
from reconstruction.methods.multiview.sweep_matcher import ViewDepth
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene
from tests.unit.reconstruction.conftest import Scene as Drawn
from tests.unit.reconstruction.conftest import make_view, write_session
from tests.unit.reconstruction.depth.small_views import PLACES, photo_of, view_at
from tests.unit.reconstruction.methods.multiview.conftest import VIEWS


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"instants": (1, 2), "page": True}, "--page shows one instant"),
        ({"depth": True}, "need --instants"),
        ({"whole": True}, "need --instants"),
        ({"rrd": True}, "need --instants"),
        ({"instants": (1,), "instant": 3}, "either --instant or --instants"),
    ],
)
def test_options_that_exclude_each_other_are_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Multiview(**options)


@pytest.mark.parametrize(
    ("options", "mesh", "cleans"),
    [
        ({}, True, True),
        ({"quick": True}, False, False),
        ({"quick": True, "mesh": True}, True, True),
        ({"mesh": False}, False, True),
        ({"mesh": False, "cloud": False}, False, False),
        ({"instants": (1,)}, False, True),
        ({"instants": (1,), "mesh": True}, True, True),
    ],
)
def test_a_single_instant_has_a_mesh_unless_it_is_quick(
    options: dict[str, Any], mesh: bool, cleans: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = Multiview(**options)
    assert (made.makes_mesh, made.cleans_cloud) == (mesh, cleans)
    monkeypatch.setattr("reconstruction.methods.multiview.multiview_options.find_spec", lambda name: None)
    assert made.cleans_cloud == mesh


def test_what_an_option_needs_is_required_before_anything_is_computed(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    needed: list[str] = []
    monkeypatch.setattr(multiview_method, "require_reconstruction", lambda name, why: needed.append(name))
    monkeypatch.setattr(multiview_method, "load_optional", lambda name, *_: needed.append(name))
    for options, packages in (
        (Multiview(workspace=False, mesh=False), []),
        (Multiview(), ["pycolmap", "open3d"]),
        (Multiview(workspace=False, mesh=False, refine=True), ["pycolmap"]),
    ):
        needed.clear()
        options.require()
        assert needed == packages
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SimulshotError, match="this machine has none"):
        Multiview(matcher=Matcher.PATCHMATCH).require()
    made: list[Any] = []
    monkeypatch.setattr(sequence, "model_sequence", lambda *given: made.append(given))
    needed.clear()
    Multiview(instants=(1,), mesh=True, rrd=True).make([trio.folder], tmp_path / "out")
    assert [*dict.fromkeys(needed)] == ["open3d", "rerun"]
    ((scene, out, condition, options),) = made
    assert (scene.dataset.name, out, condition.name) == ("boards", tmp_path / "out", "synced")
    assert options.instants == (1,)


def test_the_matcher_is_the_sweep_unless_patchmatch_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matcher, "find_gpu", lambda: ("Some GPU", Path("python")))
    assert choose_matcher(Matcher.PATCHMATCH) == ChosenMatcher(("Some GPU", Path("python")), "on Some GPU")
    assert choose_matcher(Matcher.PATCHMATCH).name == "patchmatch"
    assert choose_matcher(Matcher.SWEEP, quick=True) == ChosenMatcher(note="asked for", quick=True)
    assert choose_matcher(Matcher.AUTO) == ChosenMatcher()
    assert ChosenMatcher().name == "sweep"


def images(trio: Session) -> tuple[InputImages, dict[str, Any]]:
    inputs = InputImages(Scene(Dataset(trio)), 160)
    return inputs, {name: inputs.image(name, 1) for name in VIEWS}


def test_patchmatch_gets_a_workspace_and_the_whole_range_of_depth(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[Any] = []
    _, shown = images(trio)
    monkeypatch.setattr(matcher, "write_workspace", lambda *given, **more: calls.append((given, more)))
    monkeypatch.setattr(matcher, "run_patch_match", lambda *given: calls.append(given))
    monkeypatch.setattr(matcher, "read_maps", lambda folder, cameras: dict.fromkeys(cameras, folder))
    rough = RoughScene(
        {}, {"left": (2.0, 5.0), "middle": (1.5, 4.0), "right": (1.8, 6.0), "gone": (0.1, 99.0)}
    )
    gpu = ("Some GPU", Path("python"))
    maps = match_cameras(ChosenMatcher(gpu), tmp_path, shown, {}, rough)
    assert maps == dict.fromkeys(VIEWS, tmp_path)
    (workspace, more), run = calls
    assert run == (gpu, tmp_path, 1.5, 6.0)
    assert more == {"depth_range": (1.5, 6.0)}
    assert workspace[0] == tmp_path
    assert {name: view.width for name, view in workspace[1].items()} == dict.fromkeys(VIEWS, 160)
    assert np.array_equal(workspace[2]["left"], shown["left"].colours)


def test_what_the_sweep_matched_outside_an_image_is_no_depth(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bent = make_view((0, 0, 0), distortion=(0.4, 0.0, 0.0, 0.0, 0.0))
    photo = np.asarray(np.random.default_rng(1).integers(0, 255, (240, 320, 3)), np.uint8)
    shown = {"bent": undistort_image("bent", 0, photo, bent), "left": images(trio)[1]["left"]}
    whole = {
        name: ViewDepth(
            np.ones(image.colours.shape[:2], np.float32), np.ones(image.colours.shape, np.float32)
        )
        for name, image in shown.items()
    }
    given: list[Any] = []
    monkeypatch.setattr(matcher, "match_all_views", lambda *of, **more: given.append((of, more)) or whole)
    rough = RoughScene({}, {}, has_thin=True)
    maps = match_cameras(ChosenMatcher(quick=True), tmp_path, shown, {"left": ["bent"]}, rough)
    assert maps["left"] is whole["left"]
    outside = shown["bent"].outside
    assert 0 < outside.mean() < 0.6
    assert np.array_equal(maps["bent"].depth == 0, outside)
    assert np.array_equal((maps["bent"].normals == 0).all(2), outside)
    ((views, sources, *_), more) = given[0]
    assert ({*views}, sources) == ({"bent", "left"}, {"left": ["bent"]})
    assert more == {"has_thin": True, "quick": True, "still": None}


def test_points_are_scattered_over_all_views_between_two_depths() -> None:
    views = {name: view.undistorted for name, view in VIEWS.items()}
    points = colmap_workspace._scatter_points(views, (2.0, 8.0))
    assert len(points) == 3 * colmap_workspace.POINTS_PER_VIEW
    for place, view in enumerate(views.values()):
        part = points[place * colmap_workspace.POINTS_PER_VIEW :][: colmap_workspace.POINTS_PER_VIEW]
        seen = part @ view.rotation.T + view.translation
        at = view.project(seen)
        assert seen[:, 2].min() == pytest.approx(2, abs=0.1)
        assert seen[:, 2].max() == pytest.approx(8, rel=0.1)
        # Evenly in the inverse of the depth.
        assert np.median(seen[:, 2]) == pytest.approx(3.2, rel=0.1)
        assert np.all((at > -1) & (at < (view.width + 1, view.height + 1)))
        assert np.ptp(at, axis=0) == pytest.approx([view.width, view.height], rel=0.05)


def test_the_sparse_model_has_the_points_that_two_views_see(monkeypatch: pytest.MonkeyPatch) -> None:
    views = {"a": make_view((0, 0, 0)), "b": make_view((1.0, 0, 0))}
    points = np.array([[0.5, 0, 3.0], [0.5, 0, -3.0], [-1.4, 0, 3.0], [2.4, 0, 3.0], [0.6, 0.2, 4.0]])
    built: list[Any] = []

    def build(_: Any, views: Any, pixels: Any, shared: Any) -> None:
        built.append((views, pixels, [*shared]))

    monkeypatch.setattr(colmap_workspace, "build_model", build)
    colmap_workspace._sparse_model(None, views, points)
    ((files, pixels, shared),) = built
    assert [*files] == ["a.png", "b.png"]
    assert [(point.tolist(), seen) for point, seen in shared] == [
        (points[0].tolist(), {1: 0, 2: 0}),
        (points[4].tolist(), {1: 2, 2: 2}),
    ]
    assert [len(pixels[name]) for name in files] == [3, 3]
    assert pixels["a.png"][0] == pytest.approx(views["a"].project(points[:1])[0])


def test_a_median_is_of_what_is_known() -> None:
    nan = np.nan
    values = np.array([[1.0, nan, 3, nan], [5, nan, 1, nan], [2, 7, nan, nan]])
    assert median_of_known(values) == pytest.approx(np.array([2, 7, 2, nan]), nan_ok=True)


def test_a_camera_without_depth_says_what_it_lacks() -> None:
    shown = {name: photo_of(view_at(*place))[0] for name, place in PLACES.items()}
    ahead = np.array([[0.0, 0.0, 2.0], [0.1, 0.0, 2.0]])
    together = dict.fromkeys(shown, 0)
    unmatched = RoughScene({"left": ahead}, {})
    said = _why_alone("right", shown, unmatched, together)
    assert said == "nothing in its picture could be matched in another camera's picture"
    scene = RoughScene(dict.fromkeys(shown, ahead), {})
    said = _why_alone("right", shown, scene, together)
    assert said.startswith("no other camera suits its depth: ")
    assert " sees the most of its picture, 100 %, from an angle of " in said
    # Of those of its step, that which sees the most.
    far = RoughScene(dict.fromkeys(shown, np.array([[0.0, 0.0, 2.0], [50.0, 0.0, 2.0]])), {})
    assert ", 50 %, from" in _why_alone("right", shown, far, together)
    apart = together | {"left": 5}
    assert "left sees" not in _why_alone("right", shown, scene, apart)


def test_an_image_that_cannot_be_used_says_why(trio: Session) -> None:
    inputs, shown = images(trio)
    del inputs.views["left"]
    fresh = InputImages(Scene(Dataset(trio)))
    del fresh.views["left"]
    assert fresh.problem("left", 1) == "it is not in the calibration"
    assert fresh.problem("middle", 9) == "it has no image of instant 9"
    assert fresh.problem("middle", 1) == ""
    assert fresh.image("middle", 1).colours.shape == (240, 320, 3)
    assert shown["middle"].colours.shape == (120, 160, 3)
    assert shown["middle"].calibrated.moving.shape == (120, 160)
    with pytest.raises(SimulshotError, match=r"fewer than two cameras can be used \(left: it is not in"):
        fresh.usable({"left": 1, "middle": 1})


def result(**changes: Any) -> MultiviewResult:
    plain: dict[str, Any] = {
        "session": "s",
        "instant": 1,
        "matcher": "sweep",
        "calibration": "a board",
        "unit": "m",
        "reference": "a",
        "coverage": 0.5,
        "nearest": 1.0,
        "farthest": 4.0,
        "views": (),
        "fused_points": 9,
        "cloud_points": 9,
        "mesh_triangles": 0,
        "files": (),
        "rest_error_px": 0.1,
        "rest_points": 120,
    }
    return MultiviewResult(**(plain | changes))


def test_depth_says_what_it_rests_on() -> None:
    assert result().basis.startswith("points at rest fit within 0.10 px (120 matches)")
    assert "62 % (error unknown) of the pixels" in result(expected_within_2pct=0.62).basis
    assert "62 % (20 to 70; 95 %)" in result(expected_within_2pct=0.62, expected_range=(0.2, 0.7)).basis
    assert "two cameras do not show a turn sideways" in result(turn_error=0.02).basis
    assert "warning" not in result(scale_error=0.0049).basis
    assert "may be wrong by the same 0.5 % (standard deviation)" in result(scale_error=0.005).basis
    roughly = result(lenses=LensKnowledge(level="roughly", why="off by 3 %"))
    assert roughly.basis.startswith(
        "warning: this depth is inaccurate: focal lengths known roughly: off by 3"
    )


def test_a_recording_has_each_instants_cloud_and_images(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    logged: list[Any] = []

    @contextmanager
    def recording(name: str, file: Path, cameras: Any) -> Iterator[Any]:
        logged.append((name, file, sorted(cameras)))
        rerun = SimpleNamespace(
            Points3D=lambda points, colors: ("points", points.tolist(), colors.tolist()),
            EncodedImage=lambda contents, media_type: (media_type, contents),
        )
        yield rerun, SimpleNamespace(log=lambda name, what: logged.append((name, what)))

    monkeypatch.setattr(sequence, "rerun_recording", recording)
    monkeypatch.setattr(sequence, "set_times", lambda stream, *at: logged.append(at))
    dataset = Dataset(trio)
    calibration = trio.calibration()
    assert calibration is not None
    known = {name: camera for name, camera in calibration.cameras.items() if name != "left"}
    points, colours = np.array([[1.0, 2, 3]]), np.array([[9, 8, 7]], np.uint8)
    write_ply(tmp_path / "a.ply", PointCloud(points, colours))
    monkeypatch.setattr(dataset, "has_image", lambda camera, k: (camera, k) != ("right", 2))
    made = [SequenceInstant(instant=k, leader_ns=10 * k, cloud="a.ply") for k in (1, 2)]
    sequence.write_recording(
        tmp_path / "out.rrd", tmp_path, dataset, type(calibration)(cameras=known, unit="m", source="x"), made
    )
    cloud = ("cloud", ("points", points.tolist(), colours.tolist()))
    assert logged == [
        ("boards", tmp_path / "out.rrd", ["middle", "right"]),
        (10, 1),
        cloud,
        ("rig/middle", ("image/png", dataset.image_bytes("middle", 1))),
        ("rig/right", ("image/png", dataset.image_bytes("right", 1))),
        (20, 2),
        cloud,
        ("rig/middle", ("image/png", dataset.image_bytes("middle", 2))),
    ]
    logged.clear()
    monkeypatch.setattr(dataset, "image_bytes", lambda camera, k: b"\xff\xd8\xff photo")
    sequence.write_recording(tmp_path / "out.rrd", tmp_path, dataset, calibration, made[:1])
    assert logged[3] == ("rig/left", ("image/jpeg", b"\xff\xd8\xff photo"))


def test_views_that_are_straight_have_nothing_outside() -> None:
    plain: View = VIEWS["left"].undistorted
    photo = np.asarray(np.random.default_rng(1).integers(0, 255, (240, 320, 3)), np.uint8)
    assert not undistort_image("left", 0, photo, plain).outside.any()


def test_in_a_single_image_nothing_is_known_to_move(scene: Drawn, tmp_path: Path) -> None:
    for instants in (1, 2):
        session = write_session(tmp_path / f"{instants}", scene, {"left": VIEWS["left"]}, instants=instants)
        moving = InputImages(Scene(Dataset(session))).image("left", 0).calibrated.moving
        assert (moving is None) == (instants == 1)
