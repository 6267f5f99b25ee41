"""Exports whose pictures were redrawn for another lens are sessions again, with that lens."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.companions.exporting.export_session import export_session
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.format.calibration import CameraCalibration
from tests.imported import import_one
from tests.unit.plugins.programs.dotted import (
    WIDTH,
    Array,
    build,
    farthest_off,
    lens,
    opencv_pixel,
    undistorted,
)


@pytest.mark.parametrize("name", ["n3dv", "easyvolcap", "freemocap", "splats"])
def test_redrawn_pictures_come_back_with_their_lens(tmp_path: Path, name: str) -> None:
    session = build(tmp_path / "sessions")
    export_session(session, name, tmp_path / "out", lossless=True)
    back = import_one([str(tmp_path / "out")], tmp_path / "back", "back", ImportOptions(png=True))
    calibration = back.calibration()
    assert calibration is not None
    for camera_name, camera in calibration.cameras.items():
        assert camera != lens(camera_name)
        matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])

        def project(point: Array, camera: CameraCalibration = camera) -> Array:
            return opencv_pixel(camera, point)

        def rays(pixels: Array, camera: CameraCalibration = camera, matrix: Array = matrix) -> Array:
            return undistorted(pixels, matrix, np.array(camera.distortion))

        image = next(image for image in back.manifest.images if image.camera == camera_name)
        shown = cv2.imread(str(back.image_file(image)))
        assert shown is not None
        # A film's pixels are a sixth of the camera's own.
        assert farthest_off(shown, project, rays) < 0.01 * camera.width / WIDTH
