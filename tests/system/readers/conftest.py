"""Recordings that every reader gets: a bundled one, and one with all that exports stumble over."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.companions.exporting.export_session import export_session
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.reading.reader import Session
from tests.project import JUMPER
from tests.unit.plugins.programs.conftest import Recipe, build

SIZES = {"mid": (64, 96), "right": (128, 96)}
"""A portrait camera and a larger one; two lenses are distorted, and one image is missing."""


@pytest.fixture(params=["jumper", "distorted, portrait, two sizes, one missing"])
def session(request: pytest.FixtureRequest, tmp_path: Path) -> Session:
    if request.param == "jumper":
        return Session.open(JUMPER)
    return build(tmp_path / "sessions" / "clap", Recipe(sizes=SIZES))


@pytest.fixture
def calibrated(session: Session) -> dict[str, CameraCalibration]:
    calibration = session.calibration()
    assert calibration is not None
    return {camera.name: calibration.cameras[camera.name] for camera in session.manifest.cameras}


@pytest.fixture
def out(session: Session, tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """The session's export to the format that the test's marker `exported(format, **options)` names."""
    marker = request.node.get_closest_marker("exported")
    export_session(session, marker.args[0], tmp_path / "out", on_warning=lambda note: None, **marker.kwargs)
    return tmp_path / "out"


def in_camera(camera: CameraCalibration, points: Any) -> Any:
    """Return points of the rig (n, 3) in a camera's coordinates, in the calibration's unit."""
    return points @ np.array(camera.rotation).T + np.array(camera.translation)


def pixels(camera: CameraCalibration, points: Any) -> Any:
    """Return where a lens has points of the rig (n, 3): (n, 2), the first pixel's centre is (0, 0)."""
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    turn = cv2.Rodrigues(np.array(camera.rotation))[0]
    seen = cv2.projectPoints(
        points.reshape(-1, 1, 3), turn, np.array(camera.translation), matrix, np.array(camera.distortion)
    )
    return seen[0].reshape(-1, 2)


def points_before(cameras: dict[str, CameraCalibration], count: int = 20) -> Any:
    """Draw points (count, 3) of the rig that all cameras have in front of them, near their common axis."""
    middle = np.mean([_ahead(camera) for camera in cameras.values()], axis=0)
    return middle + np.random.default_rng(0).uniform(-0.04, 0.04, (count, 3))


def _ahead(camera: CameraCalibration) -> Any:
    rotation, translation = np.array(camera.rotation), np.array(camera.translation)
    return rotation.T @ (np.array([0.0, 0.0, max(0.5, float(np.linalg.norm(translation)))]) - translation)
