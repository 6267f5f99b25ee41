"""Poses of single instants: errors that no choice of world changes, and what is said of them."""

import sys
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.errors import NotAvailableError
from capture_app.session.reading.reader import Session
from capture_app.session.writing.store import Session as Store
from reconstruction.calibration.calibrated_views import calibrated_views
from reconstruction.common.geometry import View
from reconstruction.common.stage_cache import StageCache
from reconstruction.compare import pose_study
from reconstruction.compare.pose_study import PoseStudy
from reconstruction.poses.pose_errors import Pose, relative_pose_errors
from reconstruction.session.conditions import DISTINCT, SYNCED, Condition
from reconstruction.session.dataset import Dataset
from tests.reconstruction.conftest import VIEWS

PINWHEEL = Path(__file__).resolve().parents[2] / "sample_sessions" / "pinwheel"


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


class Fake:
    """Places cameras of one instant right, of several instants each turned by its instant's tenfold."""

    def __init__(self, dataset: Dataset, views: Mapping[str, View], folder: Path) -> None:
        self.views = views

    def find_poses(self, shown: Mapping[str, int]) -> dict[str, Pose]:
        together = len(set(shown.values())) == 1
        found = poses(self.views)
        if not together:
            del found["aside"]
        return {c: pose if together else turned(pose, 10 * shown[c]) for c, pose in found.items()}


def study(session: Session, folder: Path) -> PoseStudy:
    dataset = Dataset(session)
    calibration = session.calibration()
    assert calibration is not None
    views = calibrated_views(dataset, calibration)
    return PoseStudy(dataset, views, StageCache(folder, dataset.fingerprint()), "the boards")


def test_harm_is_told_in_cameras_pairs_and_degrees(
    boards: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pose_study, "PoseFinder", Fake)
    found = study(boards, tmp_path).compare(Condition.parse("left=0,right=33,aside=66"), "asked for")
    assert found.harmed
    assert (found.synced.registered, found.offset.registered) == (3, 2)
    assert (found.synced.right_pairs, found.offset.right_pairs) == (1, 0)
    assert found.offset.rotation_deg == pytest.approx(10, abs=0.1)
    assert [row["instant"] for row in found.per_instant] == [0, 1, 2]
    assert found.differences["right_pairs"].high == -1
    assert found.offsets_ms == {"left": 0, "right": 33, "aside": 66}
    together = study(boards, tmp_path).compare(Condition(SYNCED), "asked for")
    assert not together.harmed
    with pytest.raises(ValueError, match="equally late"):
        study(boards, tmp_path).compare(Condition.parse("7,7,7"), "asked for")


def test_two_cameras_and_no_colmap_are_said(
    boards: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair = study(boards, tmp_path)
    pair.cameras = pair.cameras[:2]
    with pytest.raises(ValueError, match="three cameras"):
        pair.compare(Condition(DISTINCT), "asked for")
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(NotAvailableError, match="needs pycolmap"):
        study(boards, tmp_path).compare(Condition(DISTINCT), "asked for")


def test_a_pinwheel_places_its_cameras_only_when_synchronized(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pose_study, "MOST_INSTANTS", 1)
    found = study(Store.open(PINWHEEL), tmp_path).compare(Condition(DISTINCT), "it turns")
    assert found.synced.registered == 5
    assert found.synced.right_pairs == 1
    assert found.synced.rotation_deg is not None
    assert found.synced.rotation_deg < 0.5
    assert found.harmed
    assert found.offset.right_pairs == 0
    assert found.offset.rotation_deg is None or found.offset.rotation_deg > 10
