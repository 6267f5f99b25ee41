"""The study of all cameras with maps that are true of their images: scores, pictures and clouds."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.common.errors import NotAvailableError
from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import Array
from reconstruction.common.matchers import Matcher
from reconstruction.method.score import Context
from reconstruction.method.study_result import StudyResult
from reconstruction.methods.multiview import multiview_study
from reconstruction.methods.multiview.fusion import FusedCloud
from reconstruction.methods.multiview.input_images import InputImages
from reconstruction.methods.multiview.instant_depth import InstantDepth, confirm
from reconstruction.methods.multiview.instant_scoring import InstantScorer
from reconstruction.methods.multiview.multiview_method import Multiview
from reconstruction.methods.multiview.multiview_study import MultiviewFacts, MultiviewStudy
from reconstruction.scene.conditions import Condition
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.moving_pixels import SceneMotion
from reconstruction.scene.scene import Scene
from tests.unit.reconstruction.methods.multiview.test_all_cameras import multiview
from tests.unit.reconstruction.methods.multiview.test_whole_instant import unmoved
from tests.unit.reconstruction.methods.multiview.true_maps import match_truly, true_view

LATE = Condition.parse("left=33,right=66")


def prepared(session: Session, **options: Any) -> MultiviewStudy:
    study = multiview(session, width=160, **options)
    study.prepare()
    return study


def both(result: StudyResult[MultiviewFacts], name: str) -> tuple[float, float]:
    values = tuple(result.value(name, side) for side in ("synced", "offset"))
    assert None not in values
    return values[0] or 0.0, values[1] or 0.0


@pytest.mark.parametrize("lacks", ["pycolmap", "points"])
def test_without_a_cloud_by_colmap_its_picture_is_left_out(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lacks: str
) -> None:
    match_truly(monkeypatch, Dataset(trio))
    if lacks == "pycolmap":
        monkeypatch.setattr(multiview_study, "find_spec", lambda name: None)
        monkeypatch.setattr(multiview_study, "fuse_by_colmap", None)
    else:
        few = np.zeros((multiview_study.MIN_POINTS - 1, 3))
        monkeypatch.setattr(multiview_study, "fuse_by_colmap", lambda *_: (few, few))
    study = prepared(trio)
    texts: list[str] = []
    monkeypatch.setattr(study.progress, "step", texts.append)
    result = study.compare(Condition.parse("left=33"), tmp_path)
    assert [picture.key for picture in result.pictures][-1] == "multiview_turntable"
    assert len(result.pictures) == 3
    now = int(result.per_instant[0]["instant"])
    assert sorted(texts) == [f"depth from 3 cameras, instant {now}, {side}" for side in ("offset", "synced")]


def test_a_map_without_what_moves_is_scored_so_and_few_points_are_not_shown(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    match_truly(monkeypatch, Dataset(trio), {"middle": unmoved})
    monkeypatch.setattr(multiview_study, "MIN_POINTS", 10**6)
    result = prepared(trio).compare(LATE, tmp_path)
    assert [picture.key for picture in result.pictures] == ["multiview_depth", "multiview_movers"]
    assert result.facts.clouds is None
    assert both(result, "mover_coverage") == both(result, "mover_within_5pct") == (0, 0)
    assert both(result, "mover_consistency") == (0, 0)
    assert both(result, "static_coverage") == both(result, "static_within_1pct") == (1, 1)


def test_the_middle_camera_is_the_one_of_the_other_session(
    trio: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, theirs = prepared(trio), multiview(trio, width=160)
    theirs.adopt(ours)
    theirs.prepare()
    assert theirs.middle_camera == "middle"
    theirs.middle_camera = "left"
    with pytest.raises(ValueError, match="its middle camera is middle, not left"):
        theirs.prepare()
    none = MultiviewStudy(Context(scene=ours.scene, options={"max_multiview_instants": 0}))
    assert (none.steps, bool(none.unasked()), ours.unasked()) == (0, True, "")
    monkeypatch.setattr(theirs.shots, "problem", lambda camera, instant: "its image is dark")
    with pytest.raises(ValueError, match="no instant has its pictures in both conditions"):
        theirs.compare(LATE)
    # Without depth of the middle camera an instant counts for neither condition.
    match_truly(monkeypatch, Dataset(trio))
    monkeypatch.setattr(Multiview, "run", lambda *_: iter(()))
    with pytest.raises(ValueError, match="no instant has depth in both conditions"):
        ours.compare(LATE)


def scorer(session: Session, unit: str = "m") -> tuple[InstantScorer, InstantDepth]:
    """A scorer of instant 1 of the middle camera, and its true depth."""
    inputs = InputImages(Scene(Dataset(session)), 160)
    truth = {camera: inputs.true_depth(camera, 1) for camera in inputs.dataset.cameras}
    maps = {camera: true_view(depth) for camera, depth in truth.items() if depth is not None}
    nothing = np.zeros((0, 3), np.float32)
    depth = InstantDepth(maps, FusedCloud(nothing, nothing, nothing, np.zeros((0, 3), bool)))
    return InstantScorer(inputs, "middle", unit, [1], [depth]), depth


def test_the_control_is_what_no_image_shows_behind_something_moving(trio: Session) -> None:
    score, depth = scorer(trio)
    shown = {"left": 2, "middle": 1, "right": 3}
    measured = score.measure(1, shown, {"synced": depth, "offset": depth})
    inputs = score.undistorted
    static = cv2.dilate(inputs.changing("middle", 1).astype(np.uint8), np.ones((3, 3), np.uint8)) == 0
    assert 0 < static.mean() < 1
    view = inputs.plain_views["middle"]
    points = view.unproject(view.grid(), depth.maps["middle"].depth.ravel())
    for camera in ("left", "right"):
        hidden = inputs.changing(camera, 1) | inputs.changing(camera, shown[camera])
        other = inputs.plain_views[camera]
        at = np.rint(other.project(points @ other.rotation.T + other.translation)).astype(int)
        inside = (at >= 0).all(1) & (at < (160, 120)).all(1)
        covered = np.zeros(len(points), bool)
        covered[inside] = hidden[at[inside, 1], at[inside, 0]]
        static &= ~covered.reshape(static.shape)
    for side in ("synced", "offset"):
        shares = measured[side].shares
        assert shares["static_coverage"][1] == pytest.approx(static.sum(), rel=0.05)
        assert shares["static_coverage"][1] == shares["static_consistency"][1]
        assert shares["mover_coverage"] == (inputs.moving("middle", 1).sum(),) * 2
        assert shares["static_precision"] == (0, 0)
        assert shares["static_recall"][0] == 0 < shares["static_recall"][1]
        assert measured[side].means["mover_points"].tolist() == [0]


def test_an_unknown_scale_is_that_of_the_still_scene(trio: Session) -> None:
    """Depth is scored, in its own unit; the cloud is not."""
    score, depth = scorer(trio, "baseline")
    twice = {camera: true_view(2 * one.depth) for camera, one in depth.maps.items()}
    doubled = InstantDepth(twice, depth.cloud)
    score = InstantScorer(score.undistorted, "middle", "baseline", [1], [doubled])
    shown = dict.fromkeys(twice, 1)
    shares = score.measure(1, shown, {"synced": doubled})["synced"].shares
    assert shares["mover_within_1pct"][0] == shares["mover_within_1pct"][1] > 1000
    assert "mover_precision" not in shares
    assert score.tolerance_m is None
    truth = score.true_depth(1)
    assert truth is not None
    assert np.nanmedian(truth / depth.maps["middle"].depth) == pytest.approx(2, rel=1e-3)


def test_two_other_maps_confirm_depth_and_one_does_not(trio: Session) -> None:
    score, depth = scorer(trio)
    images = {camera: score.undistorted.image(camera, 1).calibrated for camera in depth.maps}
    maps: dict[str, Any] = dict(depth.maps)
    confirmed, difference = confirm("middle", images, maps)
    assert confirmed.mean() > 0.8
    assert np.nanmedian(difference) < 3
    empty = maps | {"middle": true_view(np.where(np.arange(160) < 80, maps["middle"].depth, 0))}
    confirmed_half, difference = confirm("middle", images, empty)
    assert not confirmed_half[:, 80:].any()
    assert np.isnan(difference[:, 80:]).all()
    assert np.array_equal(confirmed_half[:, :80], confirmed[:, :80])
    off = maps | {"left": true_view(np.asarray(maps["left"].depth * 1.2, np.float32))}
    assert confirm("middle", images, off)[0].mean() < 0.2
    pair = {camera: maps[camera] for camera in ("middle", "right")}
    assert confirm("middle", images, pair)[0].mean() > 0.8
    wrong = maps | {"middle": true_view(np.asarray(maps["middle"].depth * 1.2, np.float32))}
    assert np.nanmedian(confirm("middle", images, wrong)[1]) > 5


def test_what_moves_is_undistorted_and_widened(trio: Session) -> None:
    dataset = Dataset(trio)
    motion = SceneMotion(dataset, 2)
    inputs = InputImages(Scene(dataset), 160, motion)
    moving, changing = inputs.moving("left", 1), inputs.changing("left", 1)
    plain = cv2.resize(motion.moving("left", 1).astype(np.uint8), (160, 120), interpolation=0)
    assert np.array_equal(moving, plain > 0)
    assert not (moving & ~changing).any()
    assert moving.sum() < changing.sum() < 0.4 * changing.size
    near: Array = cv2.dilate(
        cv2.resize(motion.changing("left", 1).astype(np.uint8), (160, 120), interpolation=0),
        np.ones((15, 15), np.uint8),
    )
    assert not (changing & (near == 0)).any()
    images, left_out = inputs.usable({"left": 1, "right": 9, "middle": 0})
    assert ([*images], left_out) == (["left", "middle"], {"right": "it has no image of instant 9"})
    assert inputs.problem("left", 1) == ""


def test_a_matcher_that_this_machine_has_not_is_refused_before_anything_is_compared(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    multiview(trio).check()
    multiview(trio, matcher=Matcher.SWEEP).check()
    with pytest.raises(NotAvailableError, match="this machine has none"):
        multiview(trio, matcher=Matcher.PATCHMATCH).check()
