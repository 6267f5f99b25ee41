"""Exports for trainers of Gaussian splats, read by the layouts that these programs document."""

from pathlib import Path
from typing import Any

import cv2  # before pycolmap
import numpy as np
import pytest

from capture_app.companions.exporting.export_session import export_session
from capture_app.session.exporting.starting_points import match_points
from capture_app.session.format.calibration import CameraCalibration
from tests.unit.plugins.programs.conftest import calibrated
from tests.unit.plugins.programs.dotted import build, farthest_off
from tests.unit.plugins.programs.test_splats import CAMERAS, Seen, few_points, read_model


@pytest.mark.parametrize("layout", ["colmap", "multipleview"])
def test_resampled_images_show_points_within_a_third_of_a_pixel(tmp_path: Path, layout: str) -> None:
    options: dict[str, Any] = {"layout": layout, "lossless": True, "points": few_points(tmp_path)}
    export_session(build(tmp_path / "sessions"), "splats", tmp_path / "out", **options)
    model = "sparse_" if layout == "multipleview" else "sparse/0"
    images, _, _ = read_model(tmp_path / "out" / model)
    if layout == "multipleview":
        assert len({image.camera for image in images}) == 1
    for number, image in enumerate(images, 1):
        file = f"cam{number:02d}/frame_00001.jpg" if layout == "multipleview" else f"images/{image.name}"
        shown = cv2.imread(str(tmp_path / "out" / file))
        width, height, fx, fy, _, _ = image.camera

        def project(point: Any, image: Seen = image) -> Any:
            return image.project(point, centred=True)[0] - 0.5

        def rays(pixels: Any, size: Any = (width, height), focal: Any = (fx, fy)) -> Any:
            return (pixels + 0.5 - np.array(size) / 2) / focal

        assert farthest_off(shown, project, rays) < 0.1


def test_matched_points_lie_on_the_wall_that_is_seen() -> None:
    texture = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 256, (400, 600, 3), np.uint8), (0, 0), 2)
    texture = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX)
    cameras, pictures = {}, {}
    for name in CAMERAS:
        own = calibrated(name, 320, 240)
        camera = CameraCalibration(
            width=320, height=240, fx=300, fy=300, cx=159.5, cy=119.5,
            rotation=own.rotation, translation=own.translation,
        )  # fmt: skip
        # A wall at z = 0 of 0.6 x 0.4 m; the texture's pixels are a millimetre.
        turn, shift = np.array(camera.rotation), np.array(camera.translation)
        matrix = np.array([[300, 0, 159.5], [0, 300, 119.5], [0, 0, 1]])
        pixels_from_wall = matrix @ np.column_stack([turn[:, 0], turn[:, 1], shift])
        metres = np.array([[0.001, 0, -0.3], [0, 0.001, -0.2], [0, 0, 1]])
        cameras[name] = camera
        pictures[name] = cv2.warpPerspective(texture, pixels_from_wall @ metres, (320, 240))
    found = match_points(cameras, pictures)
    assert len(found.points) > 100
    assert np.quantile(np.abs(found.points[:, 2]), 0.9) < 0.005
    columns, rows = np.rint((found.points[:, :2] + [0.3, 0.2]) * 1000).astype(int).T
    inside = (columns >= 0) & (columns < 600) & (rows >= 0) & (rows < 400)
    truth = texture[rows[inside], columns[inside], ::-1].astype(float)
    assert np.median(np.abs(truth - found.colours[inside])) < 12
