"""Cameras take no points as they take many: OpenCV returns nothing, or one number, for none."""

import numpy as np

from capture_app import open_session
from capture_app.session.format.lens import Lens
from reconstruction.common.geometry import View
from tests.project import JUMPER

BENT = np.array([0.1, 0.0, 0.0, 0.0, 0.0])


def test_a_distorted_view_takes_no_points() -> None:
    matrix = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
    view = View(640, 480, matrix, BENT, np.eye(3), np.zeros(3))
    assert view.project(np.zeros((0, 3))).shape == (0, 2)
    assert view.rays(np.zeros((0, 2))).shape == (0, 3)
    assert view.undistort(np.zeros((0, 2))).shape == (0, 2)
    assert Lens(matrix, BENT).rays([]).shape == (0, 2)


def test_a_session_s_camera_projects_no_points() -> None:
    camera = open_session(JUMPER).cameras["cam01"].calibration
    assert camera is not None
    assert camera.project(np.zeros((0, 3))).shape == (0, 2)
    assert camera.project(np.zeros((4, 0, 3))).shape == (4, 0, 2)
