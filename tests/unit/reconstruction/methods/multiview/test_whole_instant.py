"""An instant and a sequence of maps that are all true, or wrong where the test says: files and scores."""

import shutil
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from capture_app.common.errors import BadInputError, NotApplicableError
from capture_app.console.terminal import Progress
from capture_app.session.exporting.point_cloud import read_ply
from capture_app.session.format.calibration import Calibration
from capture_app.session.reading.reader import Session
from capture_app.session.reading.take_sheet import PAIR_DEPTH
from reconstruction.common.geometry import Array, View
from reconstruction.methods.multiview import instant_maps, instant_scoring, multiview_method, sequence
from reconstruction.methods.multiview.fusion import FusedCloud
from reconstruction.methods.multiview.input_images import InputImages, prepare_images, undistorted_truth
from reconstruction.methods.multiview.instant_maps import match_instants
from reconstruction.methods.multiview.instant_model import MadeMultiview
from reconstruction.methods.multiview.instant_scoring import score_moving, visible_points
from reconstruction.methods.multiview.multiview_method import Multiview
from reconstruction.methods.multiview.result import MultiviewResult, SequenceInstant
from reconstruction.methods.multiview.still_scene import StillScene
from reconstruction.scene.conditions import SYNCHRONIZED, Condition
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.moving_pixels import SceneMotion
from reconstruction.scene.scene import Scene
from tests.unit.reconstruction.methods.multiview.conftest import VIEWS
from tests.unit.reconstruction.methods.multiview.true_maps import match_truly

QUICK = Multiview(instant=2, width=160, quick=True, mesh=False, workspace=False)
SCORED = msgspec.structs.replace(QUICK, quick=False, cloud=False)
"""The same with a score of the cloud."""


class Steps(Progress):
    """Notes each step, and whether two cameras' depth is shown at it."""

    def __init__(self, folder: Path) -> None:
        super().__init__(0, silent=True)
        self.folder, self.shown, self.texts = folder, list[bool](), list[str]()
        self.totals: set[int] = set()

    def step(self, text: str) -> None:
        self.totals.add(self.total)
        super().step(text)
        self.shown.append((self.folder / PAIR_DEPTH).exists())
        self.texts.append(text)


def too_far(depth: Array, moving: Array) -> Array:
    """Depth of what moves, a tenth too large."""
    return np.asarray(np.where(moving, 1.1 * depth, depth).astype(np.float32))


def unmoved(depth: Array, moving: Array) -> Array:
    """Depth of what does not move."""
    return np.asarray(np.where(moving, 0, depth).astype(np.float32))


def half(depth: Array, moving: Array) -> Array:
    """Depth of the left half."""
    return np.asarray(np.where(np.arange(depth.shape[1]) < depth.shape[1] // 2, depth, 0).astype(np.float32))


def check_files(result: MultiviewResult, out: Path, dataset: Dataset) -> None:
    """The files of true maps of instant 2, with their confidence, their pictures and their cloud."""
    made = MadeMultiview(result, out)
    views = InputImages(Scene(dataset), 160).views
    for view in result.views:
        truth = undistorted_truth(dataset, views[view.camera], view.camera, 2)
        assert truth is not None
        assert np.array_equal(made.depth(view.camera), truth[0])
        assert made.normals(view.camera)[5, 5].tolist() == [0, 0, -1]
        assert made.normals(view.camera).dtype == np.float16
        assert view.expected_within_2pct == pytest.approx(made.confidence(view.camera).mean(), abs=1e-3)
        assert view.expected_range is not None
        assert 0.2 < view.expected_range[0] < view.expected_within_2pct < view.expected_range[1] < 1
        assert (view.instant, view.coverage, view.mover_coverage) == (2, 1, 1)
        assert {*view.sources} == {"left", "middle", "right"} - {view.camera}
        for folder in ("depth", "confidence"):
            assert np.asarray(cv2.imread(str(out / folder / f"{view.camera}.png"))).std() > 10
    assert result.expected_within_2pct == result.views[1].expected_within_2pct
    assert result.expected_range == result.views[1].expected_range
    cloud = made.cloud
    assert len(cloud.points) == result.fused_points > 10_000
    seen = [visible_points(views[c].undistorted, made.depth(c), cloud.points) for c in views]
    assert np.any(seen, axis=0).mean() > 0.98
    assert np.array_equal(read_ply(out / "points.ply").points, cloud.points)


def test_true_maps_give_true_figures_and_all_files(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    dataset, progress = Dataset(trio), Steps(out)
    match_truly(monkeypatch, dataset)
    options = msgspec.structs.replace(SCORED, page=True, progress=progress)
    result = options.make([trio.folder], out)
    assert isinstance(result, MultiviewResult)
    assert (result.session, result.instant, result.offsets_ms) == ("boards", 2, ())
    assert (result.reference, result.unit, result.calibration) == ("middle", "m", "boards")
    assert (result.coverage, result.moving_measured, result.median_error_pct) == (1, 1, 0)
    assert (result.within_2pct, result.mover_within_2pct, result.static_within_2pct) == (1, 1, 1)
    assert result.movers_1cm is not None
    assert result.movers_1cm.precision == 1
    assert 0.95 < result.movers_1cm.recall < result.movers_1cm.f_score < 1
    assert 1000 < result.movers_1cm.points < 0.2 * result.fused_points
    assert result.nearest < 2.2 < 4 < result.farthest
    assert result.rest_error_px is not None
    assert 0 < result.rest_error_px < 0.15
    assert result.rest_errors_px.keys() == {"left", "middle", "right"}
    assert result.rest_points > 300
    assert (result.left_out, result.turn_error) == ({}, None)
    assert (result.cloud_points, result.mesh_triangles) == (result.fused_points, 0)
    assert result.files == ("fused.ply", "points.ply", "report.html", "multiview.json")
    assert {path.name for path in out.iterdir()} == {*result.files, "depth", "confidence"}
    assert [view.camera for view in result.views] == ["left", "middle", "right"]
    check_files(result, out, dataset)
    page = (out / "report.html").read_text()
    assert "points from 3 cameras.</h1>" in page
    assert "100.0\u202f% of moving pixels have depth." in page
    assert "Points at rest fit within" in page
    assert "boards, instant 2" in page
    assert "How far to trust it" in page
    assert 'class="cloud"' in page
    # Depth of a pair is shown from the first map on, until the page is.
    assert progress.texts[-1] == "fusing the maps into a cloud"
    assert progress.shown == [False, True]
    assert progress.totals == {1 + 3 + 1}
    assert not (out / PAIR_DEPTH).exists()


def test_maps_that_are_wrong_where_something_moves_are_scored_so(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    match_truly(monkeypatch, Dataset(trio), {"left": half, "middle": unmoved, "right": too_far})
    result = msgspec.structs.replace(SCORED, check=False, page=True).make([trio.folder], tmp_path / "out")
    left, middle, right = result.views
    assert (left.coverage, left.within_2pct) == (0.5, 0.5)
    assert (middle.mover_coverage, middle.mover_within_2pct, middle.static_within_2pct) == (0, 0, 1)
    assert middle.coverage == middle.within_2pct < 1
    assert (right.mover_coverage, right.mover_within_2pct, right.static_within_2pct) == (1, 0, 1)
    assert (result.coverage, result.mover_within_2pct) == (middle.coverage, 0)
    assert result.moving_measured is not None
    assert 0 < result.moving_measured < 0.3
    assert (result.rest_error_px, result.rest_errors_px, result.rest_points) == (None, {}, 0)
    assert (result.expected_within_2pct, result.expected_range) == (None, None)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {*result.files, "depth"}
    assert "How far to trust it" not in (tmp_path / "out" / "report.html").read_text()
    # No two cameras agree about it.
    assert result.movers_1cm is None or result.movers_1cm.f_score < 0.3


def test_images_of_other_instants_are_matched_and_scored_against_the_instant(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each map is true of its own image; together they show no moving surface of the instant twice."""
    match_truly(monkeypatch, Dataset(trio))
    late = Condition.parse("66,0,-66")
    result = SCORED.make([trio.folder], tmp_path / "out", condition=late)
    assert [view.instant for view in result.views] == [4, 2, 0]
    assert result.offsets_ms == (66, 0, -66)
    assert [view.mover_within_2pct for view in result.views] == [1, 1, 1]
    assert result.movers_1cm is not None
    assert result.movers_1cm.precision == 1
    assert result.movers_1cm.recall < 0.4


def test_nothing_is_scored_without_metres(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = Scene(Dataset(trio))
    match_truly(monkeypatch, scene.dataset)
    scaleless = scene.calibrated(msgspec.structs.replace(scene.calibration, unit="baseline"))
    unscored = SCORED.make([scaleless], tmp_path / "scaleless")
    assert (unscored.unit, unscored.movers_1cm, unscored.within_2pct) == ("baseline", None, None)
    assert unscored.coverage == 1


def test_a_quick_instant_has_no_score_of_its_cloud_and_two_cameras_a_range(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = Scene(Dataset(trio))
    match_truly(monkeypatch, scene.dataset)
    quick = QUICK.make([scene], tmp_path / "quick")
    assert (quick.movers_1cm, quick.within_2pct, quick.files) == (None, 1, ("fused.ply", "multiview.json"))
    pair = msgspec.structs.replace(QUICK, without=("left",)).make([scene], tmp_path / "pair")
    assert [view.camera for view in pair.views] == ["middle", "right"]
    assert pair.turn_error is not None
    assert 0.003 < pair.turn_error < 0.3
    assert pair.expected_range is not None
    assert pair.expected_within_2pct is not None
    assert 0 <= pair.expected_range[0] < pair.expected_within_2pct < pair.expected_range[1] <= 1


def test_maps_that_no_two_cameras_share_give_no_cloud(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    empty = dict.fromkeys(("left", "right"), lambda depth, _: np.zeros_like(depth))
    match_truly(monkeypatch, Dataset(trio), empty)
    with pytest.raises(NotApplicableError, match="no point of the scene is consistent in enough cameras"):
        QUICK.make([trio.folder], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_sequence_has_each_instants_files_and_is_resumed(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    match_truly(monkeypatch, Dataset(trio), {"left": half})
    progress = Steps(out)
    options = Multiview(
        instants=(1, 2), width=160, quick=True, depth=True, mesh=False, without=("right",), progress=progress
    )
    result = options.make([trio.folder], out)
    assert [moment.instant for moment in result.instants] == [1, 2]
    assert (result.clouds, result.kept, result.masks, result.unit) == (2, 0, True, "m")
    assert result.seconds > 0
    assert "numpy" in result.versions
    moving = [moment.mover_within_2pct or 0.0 for moment in result.instants]
    assert (result.within_2pct, result.mover_within_2pct) == (0.5, pytest.approx(np.median(moving), abs=1e-4))
    assert result.mover_f_score_1cm is None
    assert progress.texts[-2:] == ["instant 1", "instant 2"]
    assert progress.totals == {3 + 2}
    for moment in result.instants:
        assert moment.leader_ns == trio.manifest.burst.instants_ns[moment.instant]
        assert (moment.cloud, moment.reference) == (f"clouds/{moment.instant:06d}.ply", "left")
        assert len(read_ply(out / moment.cloud).points) == moment.points > 5000
        assert (moment.coverage, moment.within_2pct) == (0.5, 0.5)
        assert moment.seconds > 0
        for camera in ("left", "middle"):
            with np.load(out / "depth" / camera / f"{moment.instant:06d}.npz") as maps:
                assert {*maps} == {"depth", "normals", "confidence"}
    assert {path.name for path in out.iterdir()} == {*result.files}
    assert {"clouds", "depth", "instants", "movers", "plan.json", "sequence.json"} == {*result.files}
    again = msgspec.structs.replace(options, instants=(2,)).make([trio.folder], out)
    assert (again.clouds, again.kept, again.instants) == (1, 1, result.instants[1:])
    # What is kept counts as done.
    assert progress.done == 3 + 2 + 1
    with pytest.raises(BadInputError, match="made with --depth"):
        msgspec.structs.replace(options, depth=False).make([trio.folder], out)


def test_a_sequence_leaves_out_an_instant_and_says_why(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Left has no image 66 ms after the last instants."""
    out = tmp_path / "out"
    match_truly(monkeypatch, Dataset(trio))
    # Whether rerun is there or not.
    monkeypatch.setattr(multiview_method, "load_optional", lambda *_: None)
    monkeypatch.setattr(sequence, "write_recording", lambda file, *_: file.write_bytes(b"recording"))
    progress = Steps(out)
    options = Multiview(
        instants=(1, 4), width=160, without=("right",), rrd=True, mesh=False, check=False, progress=progress
    )
    late = Condition.parse("left=66")
    result = options.make([trio.folder], out, condition=late)
    missing = result.instants[1]
    assert (result.clouds, missing.cloud) == (1, "")
    assert "instant" in missing.reason
    assert [*options.notes(result)] == [f"instant 4 has no cloud: {missing.reason}"]
    assert result.instants[0].movers_1cm is not None
    assert result.mover_f_score_1cm == result.instants[0].movers_1cm.f_score
    assert (out / "sequence.rrd").read_bytes() == b"recording"
    assert progress.texts[-3:] == ["instant 1", "instant 4", "the recording"]


def test_a_sequence_without_a_cloud_is_refused(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    match_truly(monkeypatch, Dataset(trio))
    options = Multiview(instants=(4,), width=160, without=("right",), mesh=False, check=False)
    with pytest.raises(BadInputError, match="no instant gave a cloud; instant 4: "):
        options.make([trio.folder], tmp_path / "none", condition=Condition.parse("left=66"))
    assert not (tmp_path / "none").exists()


def test_each_instant_with_depth_is_given_and_the_others_are_passed_over(
    trio: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = Dataset(trio)
    match_truly(monkeypatch, dataset, {"middle": half})
    scene, late = Scene(dataset), Condition.parse("left=66")
    progress = Steps(trio.folder)
    looked: list[list[str]] = []
    monkeypatch.setattr(StillScene, "look", lambda self, images: looked.append([*images]))
    options = msgspec.structs.replace(QUICK, without=("right",), progress=progress)
    inputs = prepare_images(scene, 160)
    assert [maps.instant for maps in match_instants(inputs, (2, 4, 1), late, options)] == [2, 1]
    assert progress.texts == ["instant 2", "instant 4", "instant 1"]
    assert progress.totals == {3}
    assert looked == [["left", "middle"]] * 2
    with pytest.raises(BadInputError):
        [*match_instants(inputs, (4,), late, options)]
    (seen,) = msgspec.structs.replace(QUICK, min_evidence=None).see(scene, SYNCHRONIZED)
    assert (seen.instant, seen.left_out) == (2, {})
    assert (seen.moment["middle"].depth > 0).mean() == 0.5
    assert seen.moment["middle"].colours.shape == (120, 160, 3)
    assert seen.moment["middle"].normals[5, 5].tolist() == [0, 0, -1]
    (sure,) = msgspec.structs.replace(QUICK, min_evidence=1.0).see(scene, SYNCHRONIZED)
    assert 0.1 < (sure.moment["left"].depth > 0).mean() < (seen.moment["left"].depth > 0).mean() == 1


def test_maps_are_written_as_a_workspace_and_cameras_without_sources_say_why(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pycolmap", reason="pycolmap has no package for this machine")
    out = tmp_path / "out"
    match_truly(monkeypatch, Dataset(trio))
    alone = {"left": ["middle"], "middle": ["left"], "right": []}
    monkeypatch.setattr(instant_maps, "choose_source_views", lambda views, points, steps_ns: alone)
    result = msgspec.structs.replace(QUICK, workspace=True, check=False).make([trio.folder], out)
    assert [view.camera for view in result.views] == ["left", "middle"]
    assert {*result.left_out} == {"right"}
    assert result.left_out["right"].startswith("no other camera suits its depth: ")
    assert result.files == ("fused.ply", "workspace", "multiview.json")
    maps = sorted(path.name for path in (out / "workspace" / "stereo" / "depth_maps").iterdir())
    assert maps == ["left.png.geometric.bin", "middle.png.geometric.bin"]
    assert {path.name for path in (out / "workspace" / "images").iterdir()} == {"left.png", "middle.png"}
    monkeypatch.setattr(
        instant_maps, "choose_source_views", lambda views, points, steps_ns: dict.fromkeys(VIEWS, ())
    )
    with pytest.raises(BadInputError):
        QUICK.make([trio.folder], tmp_path / "none")


@pytest.mark.parametrize("whole", [False, True])
def test_instants_share_what_stands_still_unless_each_is_matched_as_a_whole(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: bool
) -> None:
    scenes: list[StillScene] = []

    def make(inputs: InputImages, still: StillScene, *_: object) -> SequenceInstant:
        scenes.append(still)
        return SequenceInstant(instant=len(scenes), leader_ns=0, cloud="clouds/1.ply")

    monkeypatch.setattr(sequence, "_make", make)
    monkeypatch.setattr(sequence, "write_masks", lambda motion, out, progress: out.mkdir())
    options = Multiview(instants=(1, 2), width=160, whole=whole)
    result = options.make([trio.folder], tmp_path / "out")
    assert (result.clouds, len(scenes)) == (2, 2)
    assert (scenes[0] is scenes[1]) != whole


def test_a_cloud_is_scored_only_where_all_truth_is_known_and_something_moves(
    trio: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = Dataset(trio)
    inputs = InputImages(Scene(dataset), 160)
    images = {camera: inputs.image(camera, 2) for camera in VIEWS}
    views = {camera: image.calibrated.view for camera, image in images.items()}
    truth = {camera: undistorted_truth(dataset, inputs.views[camera], camera, 2) for camera in VIEWS}
    assert None not in truth.values()
    points = np.concatenate(
        [views[c].unproject(views[c].grid(), depth[0].ravel()) for c, depth in truth.items() if depth]
    ).astype(np.float32)
    nothing = np.zeros((len(points), 3), np.float32)
    cloud = FusedCloud(points, nothing, nothing, np.ones((len(points), 3), bool))
    score = score_moving(dataset, images, "m", 2, cloud)
    assert score is not None
    assert score.recall == 1
    assert (score.precision or 0) > 0.9
    assert score_moving(dataset, images, "baseline", 2, cloud) is None
    none = FusedCloud(points[:0], nothing[:0], nothing[:0], cloud.seen[:0])
    empty = score_moving(dataset, images, "m", 2, none)
    assert empty is not None
    assert (empty.points, empty.precision, empty.recall) == (0, None, 0)

    def changed(dataset: Dataset, view: View, camera: str, instant: int) -> tuple[Array, Array] | None:
        found = undistorted_truth(dataset, view, camera, instant)
        assert found is not None
        return None if camera == lacking else (found[0], np.zeros_like(found[1]))

    lacking = "right"
    monkeypatch.setattr(instant_scoring, "undistorted_truth", changed)
    assert score_moving(dataset, images, "m", 2, cloud) is None
    lacking = ""
    assert score_moving(dataset, images, "m", 2, cloud) is None
    # Of a late camera, the truth of both instants is needed.
    monkeypatch.setattr(
        instant_scoring,
        "undistorted_truth",
        lambda *of: None if of[2:] == ("right", 2) else undistorted_truth(*of),
    )
    late = {**images, "right": inputs.image("right", 3)}
    assert score_moving(dataset, late, "m", 2, cloud) is None


def test_runs_of_one_width_share_images_and_a_known_calibration_is_taken(trio: Session) -> None:
    scene = Scene(Dataset(trio))
    first, second = InputImages(scene, 160), InputImages(scene, 160)
    assert first.image("left", 1) is second.image("left", 1)
    assert first.image("left", 1) is not InputImages(scene, 200).image("left", 1)
    assert Multiview(calibrated=True).prepared(scene) is scene
    with pytest.raises(BadInputError, match="nobody"):
        Multiview(without=("nobody",)).prepared(scene)


def test_runs_to_one_folder_share_the_calibration_that_was_guessed(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, out = tmp_path / "bare", tmp_path / "out"
    shutil.copytree(trio.folder, session)
    (session / "calibration.json").unlink()
    known, guesses = trio.calibration(), list[SceneMotion]()
    assert known is not None

    def guess(motion: SceneMotion) -> Calibration:
        guesses.append(motion)
        return msgspec.structs.replace(known, source="a guess")

    monkeypatch.setattr("reconstruction.scene.scene.guess_calibration", guess)
    match_truly(monkeypatch, Dataset(trio))
    options = Multiview(instants=(1,), width=160, quick=True, without=("right",))
    first = options.make([session], out)
    assert (first.calibration, len(guesses)) == ("a guess", 1)
    stored = msgspec.json.decode((out / "calibration.json").read_bytes(), type=Calibration)
    assert stored.cameras == known.cameras
    again = msgspec.structs.replace(options, instants=(2,)).make([session], out)
    assert (again.calibration, len(guesses)) == ("a guess", 1)
