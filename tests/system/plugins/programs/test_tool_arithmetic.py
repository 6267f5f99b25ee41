"""Each export opened by its tool's own arithmetic, written here from the tool's source: exact to 0.01 px.

The pictures are read from the export and the dots in them found where the tool, with the numbers of the
export, has the points.
"""

import math
import tomllib
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from capture_app.companions.exporting.export_session import export_session
from capture_app.plugins.programs.n3dv import POINTS as N3DV_POINTS
from capture_app.session.reading.reader import Session
from tests.unit.plugins.programs.dotted import (
    CAMERAS,
    POINTS,
    Array,
    farthest_off,
    lens,
    opencv_pixel,
    undistorted,
)
from tests.unit.plugins.programs.test_tool_arithmetic import (
    EXACT_PX,
    first_frame,
    session,  # noqa: F401 - a fixture
)


@pytest.mark.parametrize("whole", [False, True])
def test_4dgaussians(session: Session, tmp_path: Path, whole: bool) -> None:
    """Its loader: scene/neural_3D_dataset_NDC.py, utils/graphics_utils.py, the rasterizer's ndc2Pix."""
    report = export_session(session, "n3dv", tmp_path / "out", lossless=True, whole=whole)
    assert any("the films are cut" in note for note in report.notes) is not whole
    rows = np.load(tmp_path / "out" / "poses_bounds.npy")
    poses = rows[:, :15].reshape(-1, 3, 5)
    wide, high = 1352, 1014
    focal = poses[0, 2, 4] / (2704 / wide)
    half_x, half_y = math.atan(wide / (2 * focal)), math.atan(high / (2 * focal))
    for number in range(len(CAMERAS)):
        pose = poses[number]
        right_up_back = np.stack([pose[:, 1], -pose[:, 0], pose[:, 2]], axis=1)
        rotation = -right_up_back
        rotation[:, 0] = -rotation[:, 0]
        translation = -pose[:, 3] @ rotation

        def project(point: Array, rotation: Array = rotation, translation: Array = translation) -> Array:
            x, y, z = rotation.T @ point + translation
            device = np.array([x / z / math.tan(half_x), y / z / math.tan(half_y)])
            return np.asarray(((device + 1) * [wide, high] - 1) / 2)

        def rays(pixels: Array) -> Array:
            device = (2 * pixels + 1) / [wide, high] - 1
            return np.asarray(device * [math.tan(half_x), math.tan(half_y)])

        film = first_frame(tmp_path / "out" / f"cam{number:02d}.mp4")
        small = cv2.resize(film, (wide, high), interpolation=cv2.INTER_AREA)
        assert farthest_off(small, project, rays) < EXACT_PX
        # Nothing is black, or around the whole picture: the films show no more than the camera saw.
        assert bool(small.min() < 5) is whole
        if not whole:
            assert small.min() >= 38
    cloud = (tmp_path / "out" / N3DV_POINTS).read_bytes()
    assert cloud.startswith(b"ply\nformat binary_little_endian 1.0\nelement vertex 40000\n")


def test_freemocap_2(session: Session, tmp_path: Path) -> None:
    """core/tasks/calibration/shared: CameraIntrinsics.to_dist_coeffs has four, Triangulator.project."""
    report = export_session(session, "freemocap", tmp_path / "out", lossless=True)
    tables = tomllib.loads((tmp_path / "out" / "dots_camera_calibration.toml").read_text())
    videos = sorted((tmp_path / "out" / "synchronized_videos").iterdir())
    assert [path.name for path in videos] == [
        "dots.id-cam_000_cam9.idx-0.mp4",
        "dots.id-cam_001_cam10.idx-1.mp4",
    ]
    for path in videos:
        table = tables[path.name.split(".id-")[1].split(".idx-")[0]]
        assert table["id"] == table["name"]
        assert f"idx-{table['index']}.mp4" in path.name
        matrix = np.array(table["matrix"])
        four = np.array(table["distortions"][:4])
        turn, shift = np.array(table["rotation"]), np.array(table["translation"])

        def project(
            point: Array, turn: Array = turn, shift: Array = shift, matrix: Array = matrix, four: Array = four
        ) -> Array:
            return np.asarray(
                cv2.projectPoints(1000 * point.reshape(1, 1, 3), turn, shift, matrix, four)[0]
            ).reshape(2)

        def rays(pixels: Array, matrix: Array = matrix, four: Array = four) -> Array:
            return undistorted(pixels, matrix, four)

        assert farthest_off(first_frame(path), project, rays) < EXACT_PX
    # What it would have been: k3 dropped.
    plain = msgspec.structs.replace(lens("cam10"), distortion=(*lens("cam10").distortion[:4], 0.0))
    off = [np.linalg.norm(opencv_pixel(plain, p) - opencv_pixel(lens("cam10"), p)) for p in POINTS]
    assert max(off) > 0.1
    assert sum("FreeMoCap knows no k3" in note for note in report.notes) == 2
