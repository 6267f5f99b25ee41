"""Exports for motion capture, read by Caliscope, FreeMoCap's Anipose and Pose2Sim themselves.

`make readers` installs the programs.
"""

import tomllib
from pathlib import Path

import msgspec
import numpy as np
import pytest

from capture_app.companions.exporting.export_session import export_session
from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.session.format.lens import lens_of
from capture_app.session.reading.reader import Session
from tests.system.readers.conftest import SIZES, in_camera, pixels, points_before
from tests.unit.plugins.programs.conftest import Recipe, build

pytestmark = pytest.mark.filterwarnings("ignore")  # of these programs, about what they import
Cameras = dict[str, CameraCalibration]


@pytest.mark.exported("caliscope")
def test_caliscope_has_poses_frames_and_times(session: Session, calibrated: Cameras, out: Path) -> None:
    reason = "caliscope is not installed"
    arrays = pytest.importorskip("caliscope.cameras.camera_array", reason=reason)
    timestamps = pytest.importorskip("caliscope.recording.synchronized_timestamps", reason=reason)
    sources = pytest.importorskip("caliscope.recording.frame_source", reason=reason)
    array = arrays.CameraArray.from_toml(out / "camera_array.toml")
    points = points_before(calibrated)
    numbers = sorted(array.cameras)  # those of the cameras' names, where they have some
    for number, camera in zip(numbers, calibrated.values(), strict=True):
        seen = np.c_[points, np.ones(len(points))] @ array.normalized_projection_matrices[number].T
        assert seen == pytest.approx(in_camera(camera, points), abs=1e-9)
        assert array.cameras[number].size == (camera.width, camera.height)
    (recording,) = (out / "recordings").iterdir()
    synced = timestamps.SynchronizedTimestamps.load(recording, numbers)
    saved = [
        sorted(image.instant for image in session.manifest.images if image.camera == name)
        for name in calibrated
    ]
    instants = range(len(session.manifest.burst.instants_ns))
    expected = [tuple(of.index(instant) if instant in of else None for of in saved) for instant in instants]
    assert [
        tuple(synced.frame_for(index, number) for number in numbers) for index in synced.sync_indices
    ] == expected
    for number, of in zip(numbers, saved, strict=True):
        with sources.FrameSource(recording, number) as video:
            for frame in range(len(of)):
                shown = video.next_frame().frame_time
                assert shown == pytest.approx(synced.time_for(number, frame), abs=0.6e-6)


def test_anipose_and_caliscope_have_the_rays_of_fisheyes(tmp_path: Path) -> None:
    """Caliscope's table of a camera is Anipose's."""
    anipose = pytest.importorskip("aniposelib.cameras", reason="aniposelib is not installed")
    arrays = pytest.importorskip("caliscope.cameras.camera_array", reason="caliscope is not installed")
    session = build(tmp_path / "sessions" / "clap", Recipe(sizes=SIZES))
    wide = {
        name: msgspec.structs.replace(
            lens, fx=0.4 * lens.width, model="fisheye", distortion=(-0.02, 0.004, -0.001, 0.0003)
        )
        for name, lens in session.calibration().cameras.items()
    }
    (session.folder / "calibration.json").write_bytes(msgspec.json.encode(Calibration(cameras=wide)))
    export_session(Session.open(session.folder), "caliscope", tmp_path / "out", on_warning=lambda note: None)
    file = tmp_path / "out" / "camera_array.toml"
    tables = tomllib.loads(file.read_text())["cameras"]
    group = anipose.CameraGroup.from_dicts([{"name": number, **table} for number, table in tables.items()])
    array = arrays.CameraArray.from_toml(file)
    points = np.random.default_rng(0).uniform((-1.5, -1.2, 0.7), (1.5, 1.2, 1.7), (60, 3))
    for lens, theirs, other in zip(wide.values(), group.cameras, array.cameras.values(), strict=True):
        there = in_camera(lens, points)
        rays = there[:, :2] / there[:, 2:]
        seen = lens_of(lens).project(rays)
        assert np.hypot(*rays.T).max() > 1.4
        assert theirs.project(points).reshape(-1, 2) == pytest.approx(seen, abs=1e-6)
        assert theirs.undistort_points(seen) == pytest.approx(rays, abs=1e-6)
        assert other.undistort_points(seen, output="normalized") == pytest.approx(rays, abs=1e-6)


@pytest.mark.exported("freemocap")
def test_anipose_has_every_lens_of_freemocap(session: Session, calibrated: Cameras, out: Path) -> None:
    cameras = pytest.importorskip("aniposelib.cameras", reason="aniposelib is not installed")
    group = cameras.CameraGroup.load(str(out / f"{session.manifest.name}_camera_calibration.toml"))
    assert group.get_names() == [*calibrated]
    points = points_before(calibrated)
    for seen, camera in zip(group.project(1000 * points), calibrated.values(), strict=True):
        assert seen.reshape(-1, 2) == pytest.approx(pixels(camera, points), abs=0.02)


@pytest.mark.exported("pose2sim")
def test_pose2sim_has_every_projection(calibrated: Cameras, out: Path) -> None:
    common = pytest.importorskip("Pose2Sim.common", reason="pose2sim is not installed")
    points = points_before(calibrated)
    for matrix, camera in zip(
        common.computeP(out / "calibration" / "Calib.toml", undistort=False), calibrated.values(), strict=True
    ):
        seen = np.c_[points, np.ones(len(points))] @ np.array(matrix).T
        x, y, z = in_camera(camera, points).T
        truth = np.c_[camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy]
        assert seen[:, :2] / seen[:, 2:] == pytest.approx(truth, abs=1e-6)
