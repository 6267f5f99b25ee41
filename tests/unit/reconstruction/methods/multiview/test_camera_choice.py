"""Which cameras the study of all cameras compares, and whether their calibration fits their images."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.session.reading.reader import Session
from reconstruction.common.geometry import View
from reconstruction.methods.multiview import multiview_study
from reconstruction.methods.multiview.input_images import InputImages, check_images
from reconstruction.methods.multiview.multiview_study import MultiviewStudy
from reconstruction.scene.dataset import Dataset
from reconstruction.scene.scene import Scene as OpenScene
from tests.unit.reconstruction.conftest import FOCAL, Scene, make_view, write_session
from tests.unit.reconstruction.methods.multiview.conftest import VIEWS

FOUR = {**VIEWS, "aside": make_view((0.1, 0.0, 0.0), yaw=75)}


@pytest.fixture(scope="module")
def four(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Three cameras beside each other and one that looks elsewhere; the first instant lacks an image."""
    root = tmp_path_factory.mktemp("four")
    return write_session(root, scene, FOUR, instants=2, truth=False, missing={("right", 0)})


def study_of(session: Session) -> MultiviewStudy:
    study: Any = MultiviewStudy.__new__(MultiviewStudy)
    study.dataset = Dataset.open(session.folder)
    study.shots = InputImages(OpenScene(study.dataset))
    return study


def test_cameras_that_see_the_same_are_compared_on_the_pixels_of_the_middle_one(four: Session) -> None:
    study = study_of(four)
    study._choose_cameras(0)
    assert (study.reference, study.cameras) == ("middle", ("left", "middle", "right"))
    assert study.left_out == {"aside": "overlaps too little with any two others"}


def test_cameras_beyond_those_that_are_compared_are_named(
    four: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(multiview_study, "MAX_CAMERAS", 2)
    monkeypatch.setattr(multiview_study, "MIN_CAMERAS", 2)
    study = study_of(four)
    study._choose_cameras(0)
    assert len(study.cameras) == 2
    assert "middle" in study.cameras
    assert sorted(study.left_out.values()) == [
        "2 cameras are enough to compare conditions", "overlaps too little with any two others",
    ]  # fmt: skip


def test_two_cameras_are_too_few_and_it_is_said_why(four: Session, tmp_path: Path, scene: Scene) -> None:
    pair = {name: FOUR[name] for name in ("left", "middle", "aside")}
    session = write_session(tmp_path, scene, pair, instants=2, truth=False)
    with pytest.raises(ValueError, match="it takes 3 cameras with overlapping views") as raised:
        study_of(session)._choose_cameras(0)
    assert "aside" in str(raised.value)


def turned(view: View) -> View:
    rotation = cv2.Rodrigues(np.array([0.02, 0.0, 0.0]))[0]
    return replace(view, rotation=rotation @ view.rotation, translation=rotation @ view.translation)


def test_images_are_checked_against_their_calibration(four: Session) -> None:
    inputs = InputImages(OpenScene(Dataset.open(four.folder)))
    images = {name: inputs.image(name, 1) for name in VIEWS}
    assert check_images(images).error_px < 0.3
    right = images["right"]
    images["right"] = replace(right, calibrated=replace(right.calibrated, view=turned(right.calibrated.view)))
    assert check_images(images).error_px > 0.02 * FOCAL / 4
