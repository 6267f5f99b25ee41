"""The parts of a comparison that take all cameras: depth of the middle one, the cloud, and what cannot be."""

import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.session.reading.reader import Session
from reconstruction.common.matchers import Matcher
from reconstruction.method.study_result import StudyResult
from reconstruction.methods.multiview.colmap_workspace import ENVIRONMENT
from reconstruction.methods.multiview.input_images import InputImages
from reconstruction.methods.multiview.matcher import (
    choose_matcher,
)
from reconstruction.methods.multiview.multiview_method import Multiview
from reconstruction.methods.multiview.sweep_matcher import ViewDepth
from reconstruction.scene.conditions import DISTINCT, Condition
from reconstruction.scene.scene import Scene as OpenScene
from tests.unit.reconstruction.conftest import HEIGHT, WIDTH, Reconstruct, Scene, make_view, write_session
from tests.unit.reconstruction.found import study, values
from tests.unit.reconstruction.methods.multiview.conftest import VIEWS
from tests.unit.reconstruction.methods.multiview.test_all_cameras import multiview
from tests.unit.reconstruction.methods.multiview.true_workspace import write_true_workspace


def medians(found: StudyResult[Any], side: str = "synced") -> dict[str, float]:
    return {one.name: value for one in found.measures if (value := found.value(one.name, side)) is not None}


def test_only_what_moves_is_lost_when_every_camera_is_off(
    trio: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = multiview(trio)
    whole.prepare()
    assert (whole.reference, whole.cameras) == ("middle", ("left", "middle", "right"))
    found = whole.compare(Condition(DISTINCT))
    synced, offset = medians(found), medians(found, "offset")
    for lost in ("mover_within_2pct", "mover_coverage", "mover_consistency"):
        assert synced[lost] > offset[lost] + 0.4, lost
    # At 1 cm, where a pixel is 7 mm wide, not half of the points are right at best.
    assert synced["mover_f_score"] > 0.3
    assert offset["mover_f_score"] < 0.05
    for kept in ("static_within_2pct", "static_coverage", "static_consistency", "static_f_score"):
        assert synced[kept] > 0.2, kept
        # At 1 cm the distorted camera's points count, whose rays are exact: 0.474 and 0.420 are right.
        assert abs(synced[kept] - offset[kept]) < (0.07 if kept == "static_f_score" else 0.02), kept
    assert synced["mover_within_1pct"] <= synced["mover_within_2pct"] <= synced["mover_within_5pct"]
    assert synced["mover_points"] > 500
    assert offset["mover_points"] < 0.2 * synced["mover_points"]
    assert offset["mover_photometric_error"] > 2 * synced["mover_photometric_error"]
    assert found.facts.tolerance_m == 0.01
    (row,) = found.per_instant
    late = [row[f"offset_{camera}_ms"] for camera in VIEWS]
    assert late[1] == 0
    assert len(set(late)) == 3
    # The same once more runs no method again.
    monkeypatch.setattr(Multiview, "run", lambda self, scene, condition: iter(()))
    assert whole.compare(Condition(DISTINCT)) == found


def test_compare_tells_of_all_cameras_in_every_condition(
    trio: Session, tmp_path: Path, reconstruct: Reconstruct
) -> None:
    out = tmp_path / "out"
    quick = ("--max-instants", 1, "--max-multiview-instants", 1, "--multiview-width", 160)
    further = ("--condition", "66,0,33", "--condition", "distinct", "--against", trio.folder)
    result = reconstruct("compare", trio.folder, *quick, *further, "--out", out, "--json").result
    whole = study(result, "multiview")
    assert whole["skipped"] == ""
    assert [one["other"] for one in result["rig_timing"]["cameras"] if one["synchronized"]] == [
        "middle",
        "right",
    ]
    assert "Time offset of each camera against left" in (out / result["report"]).read_text()
    assert whole["facts"]["width_px"] == 160
    assert values(whole)["mover_coverage"] > values(whole, "offset")["mover_coverage"] + 0.4
    assert "of the picture" in study(result, "poses")["skipped"]
    listed, drawn, itself = result["conditions"]
    assert study(listed, "multiview")["offsets_ms"] == {"left": 66, "middle": 0, "right": 33}
    assert values(study(listed, "multiview"), "offset")["mover_coverage"] < 0.5
    assert study(drawn, "multiview") == whole
    theirs = values(study(itself, "multiview"), "offset")
    assert abs(theirs["mover_coverage"] - values(whole)["mover_coverage"]) < 0.05
    skipped = {one["name"] for each in result["conditions"] for one in each["studies"] if one["skipped"]}
    assert skipped <= {"panorama"}
    assert [picture["key"] for picture in whole["pictures"]] == [
        "multiview_depth",
        "multiview_movers",
        "multiview_turntable",
        "multiview_colmap",
    ]
    for picture in whole["pictures"]:
        assert (out / picture["synced"]).is_file()
        assert (out / picture["offset"]).is_file()


def test_a_comparison_takes_the_matcher_that_is_asked_for(
    trio: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reconstruct: Reconstruct
) -> None:
    """The process that uses the GPU is stood in for by one that copies the true maps of instant 2."""
    monkeypatch.setenv("PATH", str(tmp_path))
    failed = reconstruct("compare", trio.folder, "--matcher", "patchmatch", "--out", tmp_path / "none")
    assert failed.code == 6
    assert "this machine has none" in failed.complaint
    assert not (tmp_path / "none").exists()
    write_true_workspace(tmp_path / "true", trio, VIEWS, 2)
    asked = tmp_path / "asked"
    for name, body in {
        "nvidia-smi": "echo Some GPU",
        "python": f'/bin/cp -r {tmp_path}/true/stereo/*_maps "$3/stereo/"; echo one >> {asked}',
    }.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{body}\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv(ENVIRONMENT, str(tmp_path / "python"))
    whole = multiview(trio, matcher=Matcher.PATCHMATCH)
    whole.prepare()
    found = whole.compare(Condition(DISTINCT))
    assert (found.facts.matcher, found.facts.matcher_note) == ("patchmatch", "on Some GPU")
    assert asked.read_text().split() == ["one", "one"]
    (row,) = found.per_instant
    assert row["instant"] == 2
    assert medians(found)["mover_within_2pct"] > 0.95
    assert medians(found)["static_consistency"] > 0.5
    assert medians(found)["mover_points"] > 500
    assert multiview(trio).matcher == choose_matcher(Matcher.AUTO, quick=True)


@pytest.fixture
def matched(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    """No matching: depth of 2 everywhere and no cloud; the cameras of each instant and condition."""
    calls: list[tuple[str, ...]] = []

    def flat_depth(method: Multiview, scene: OpenScene, condition: Condition) -> Iterator[Any]:
        used = tuple(name for name in scene.dataset.cameras if name not in method.without)
        views = InputImages(scene, method.width).plain_views
        maps = {
            name: ViewDepth(
                np.full((views[name].height, views[name].width), 2.0, np.float32),
                np.zeros((views[name].height, views[name].width, 3), np.float32),
            )
            for name in used
        }
        empty = SimpleNamespace(points=np.zeros((0, 3)), colours=np.zeros((0, 3), np.uint8))
        for instant in method.listed_instants:
            calls.append(used)
            yield SimpleNamespace(instant=instant, maps=maps, cloud=empty)

    monkeypatch.setattr(Multiview, "run", flat_depth)
    return calls


def darken(session: Session, folder: Path, images: Iterable[tuple[str, int]]) -> Session:
    """A copy of a session in which these images are black."""
    copy = Session.open(shutil.copytree(session.folder, folder))
    records = {(record.camera, record.instant): record for record in copy.manifest.images}
    for image in images:
        black = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        copy.image_file(records[image]).write_bytes(cv2.imencode(".png", black)[1].tobytes())
    return copy


def test_instants_without_a_picture_of_every_camera_are_left_out(
    scene: Scene, tmp_path: Path, matched: list[tuple[str, ...]]
) -> None:
    session = write_session(tmp_path / "session", scene, VIEWS, missing={("left", 1)})
    whole = multiview(session, instants=9, width=160)
    whole.prepare()
    found = whole.compare(Condition.parse("middle=0,left=66,right=33"))
    # Left shows instant k + 2, right k + 1: from instant 3 on the burst is over, at 1 left has none.
    assert [row["instant"] for row in found.per_instant] == [0, 2]
    assert found.offsets_ms == {"left": 66, "middle": 0, "right": 33}
    assert set(matched) == {("left", "middle", "right")}
    # At the rim two other cameras do not see it.
    assert medians(found)["static_consistency"] > 0.85
    assert found.value("mover_points") == 0
    assert found.facts.width_px == 160
    with pytest.raises(ValueError, match="equally late"):
        whole.compare(Condition.parse("5,5,5"))
    with pytest.raises(ValueError, match="no instant is 300 ms"):
        whole.compare(Condition.parse("left=300"))


@pytest.mark.usefixtures("matched")
def test_a_black_picture_leaves_its_camera_out(trio: Session, tmp_path: Path) -> None:
    session = darken(trio, tmp_path / "dark", [("left", 2)])
    whole = multiview(session, instants=9, width=160)
    whole.prepare()
    assert len(whole.cameras) == 3
    found = whole.compare(Condition.parse("left=33"))
    # Left is black at 2, which is its own picture at 2 and its late one at 1; at 4 the burst is over.
    assert [row["instant"] for row in found.per_instant] == [0, 3]
    night = darken(trio, tmp_path / "night", [(camera, k) for camera in VIEWS for k in range(5)])
    with pytest.raises(ValueError, match="left, middle, right: its image has the same brightness"):
        multiview(night).prepare()


def test_more_cameras_than_needed_are_left_out(
    scene: Scene, tmp_path: Path, matched: list[tuple[str, ...]]
) -> None:
    views = {f"cam{i}": make_view((0.1 * (i - 3), 0.0, 0.0)) for i in range(7)}
    session = write_session(tmp_path, scene, views, instants=3)
    whole = multiview(session, width=160, middle=1)
    whole.prepare()
    assert whole.reference == "cam3"
    assert len(whole.cameras) == 5
    assert len(whole.left_out) == 2
    whole.compare(Condition.parse("cam3=33"))
    assert {len(cameras) for cameras in matched} == {5}
