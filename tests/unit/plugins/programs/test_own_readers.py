"""The motion-capture programs' own readers; skipped where those large packages are not installed.

To run them all: pip install caliscope aniposelib pose2sim
"""

from pathlib import Path

import numpy as np
import pytest

from tests.unit.plugins.programs.conftest import POINT, Export, Make, calibrated, spot

CAMERAS = ("left", "mid", "right")
pytestmark = pytest.mark.filterwarnings("ignore")


def test_caliscope(make: Make, export: Export, tmp_path: Path) -> None:
    reason = "caliscope is not installed"
    arrays = pytest.importorskip("caliscope.cameras.camera_array", reason=reason)
    timestamps = pytest.importorskip("caliscope.recording.synchronized_timestamps", reason=reason)
    sources = pytest.importorskip("caliscope.recording.frame_source", reason=reason)
    export(make(), "caliscope")
    array = arrays.CameraArray.from_toml(tmp_path / "out" / "camera_array.toml")
    for number, name in enumerate(CAMERAS):
        seen = array.normalized_projection_matrices[number] @ [*POINT, 1.0]
        truth = np.array(calibrated(name).rotation) @ POINT + calibrated(name).translation
        assert seen == pytest.approx(truth, abs=1e-9)
    recording = tmp_path / "out" / "recordings" / "clap"
    synced = timestamps.SynchronizedTimestamps.load(recording, [0, 1, 2])
    found = [tuple(synced.frame_for(index, camera) for camera in range(3)) for index in synced.sync_indices]
    assert found == [(0, 0, 0), (1, 1, None), (2, 2, 1), (3, 3, 2)]
    for camera in range(3):
        with sources.FrameSource(recording, camera) as video:
            for frame in range(4 if camera < 2 else 3):
                shown = video.next_frame().frame_time
                assert shown == pytest.approx(synced.time_for(camera, frame), abs=0.6e-6)


def test_freemocaps_anipose(make: Make, export: Export, tmp_path: Path) -> None:
    cameras = pytest.importorskip("aniposelib.cameras", reason="aniposelib is not installed")
    export(make(), "freemocap")
    group = cameras.CameraGroup.load(str(tmp_path / "out" / "clap_camera_calibration.toml"))
    assert group.get_names() == list(CAMERAS)
    pixels = group.project(1000 * POINT.reshape(1, 3)).reshape(3, 2)
    assert pixels == pytest.approx(np.array([spot(calibrated(name)) for name in CAMERAS]), abs=1e-3)


def test_pose2sim(make: Make, export: Export, tmp_path: Path) -> None:
    common = pytest.importorskip("Pose2Sim.common", reason="pose2sim is not installed")
    export(make(), "pose2sim")
    matrices = common.computeP(tmp_path / "out" / "calibration" / "Calib.toml", undistort=False)
    for name, matrix in zip(CAMERAS, matrices, strict=True):
        camera = calibrated(name)
        x, y, z = np.array(camera.rotation) @ POINT + camera.translation
        pixel = (camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy)
        seen = np.array(matrix) @ [*POINT, 1.0]
        assert seen[:2] / seen[2] == pytest.approx(pixel, abs=1e-6)
