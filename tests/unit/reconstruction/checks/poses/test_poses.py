"""Poses of single instants: errors that no choice of world changes, and what is said of them."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.common.errors import NotAvailableError
from capture_app.session.reading.reader import Session
from reconstruction.checks.poses.pose_study import Pose, PoseFinder, PoseStudy, relative_pose_errors
from reconstruction.common.geometry import View
from reconstruction.method.score import Context
from reconstruction.method.study_result import StudyResult
from reconstruction.scene.conditions import DISTINCT, SYNCED, Condition
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene as OpenScene
from tests.unit.reconstruction.conftest import VIEWS, Scene, write_session


def poses(views: Mapping[str, View]) -> dict[str, Pose]:
    return {name: (view.rotation, view.translation) for name, view in views.items()}


def turned(pose: Pose, degrees: float) -> Pose:
    """A camera turned about its own axis, where it stands."""
    turn = cv2.Rodrigues(np.array([0.0, 0.0, np.radians(degrees)]))[0]
    return turn @ pose[0], turn @ pose[1]


def test_errors_are_those_between_the_cameras() -> None:
    true = poses(VIEWS)
    assert np.max(relative_pose_errors(true, true)) < 1e-3
    world = cv2.Rodrigues(np.array([0.3, -1.0, 0.5]))[0]
    moved = {
        name: (turn @ world.T, 3.0 * way + turn @ world.T @ (1, 2, 3)) for name, (turn, way) in true.items()
    }
    assert np.max(relative_pose_errors(moved, true)) < 1e-3
    wrong = true | {"left": turned(true["left"], 10)}
    errors = relative_pose_errors(wrong, true)
    assert len(errors) == 3
    assert sorted(round(rotation, 3) for rotation, _ in errors) == [0, 10, 10]
    assert relative_pose_errors({"left": true["left"]}, true) == []


class Fake(PoseFinder):
    """Places cameras of one instant right, of several instants each turned by its instant's tenfold."""

    def __init__(self, dataset: Dataset, views: Mapping[str, View], folder: Path) -> None:
        self.views = views

    def find_poses(self, shown: Mapping[str, int]) -> dict[str, Pose]:
        together = len(set(shown.values())) == 1
        found = poses(self.views)
        if not together:
            del found["aside"]
        return {c: pose if together else turned(pose, 10 * shown[c]) for c, pose in found.items()}


class FakePoses(PoseStudy):
    """The study with these poses."""

    finder = Fake


def study(session: Session, kind: type[PoseStudy] = PoseStudy) -> PoseStudy:
    dataset = Dataset(session)
    return kind(Context(scene=OpenScene(dataset), step=2))


def compared(poses: PoseStudy, condition: Condition) -> StudyResult[Any]:
    poses.prepare()
    return poses.compare(condition)


def test_harm_is_told_in_cameras_pairs_and_degrees(boards: Session) -> None:
    found = compared(study(boards, kind=FakePoses), Condition.parse("left=0,right=33,aside=66"))
    assert found.facts.degraded
    assert found.first_known("registered") == ("registered", 3, 2)
    assert found.first_known("correct_pairs") == ("correct_pairs", 1, 0)
    assert found.value("rotation_deg", "offset") == pytest.approx(10, abs=0.1)
    assert [row["instant"] for row in found.per_instant] == [0, 1, 2]
    (right,) = (one for one in found.measures if one.name == "correct_pairs")
    assert right.difference is not None
    assert right.difference.high == -1
    assert found.offsets_ms == {"left": 0, "right": 33, "aside": 66}
    together = compared(study(boards, kind=FakePoses), Condition(SYNCED))
    assert not together.facts.degraded
    with pytest.raises(ValueError, match="equally late"):
        compared(study(boards, kind=FakePoses), Condition.parse("7,7,7"))


def test_two_cameras_and_no_colmap_are_said(
    boards: Session, scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair = write_session(tmp_path, scene, {name: VIEWS[name] for name in ("left", "right")}, instants=2)
    with pytest.raises(ValueError, match="three cameras"):
        compared(study(pair), Condition(DISTINCT))
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(NotAvailableError, match="needs pycolmap"):
        compared(study(boards), Condition(DISTINCT))
