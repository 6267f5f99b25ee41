"""Folders of other programs are recognized, and our own exports come back with their times."""

import shutil
from pathlib import Path

import pytest

from capture_app.cli import run
from capture_app.errors import BadInputError, ExitCode
from capture_app.session.importers.embedded_times import TimeSource
from capture_app.session.importers.recording import ImportOptions, import_recording
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.session.importers.numbered_video import numbers_of, times_of, write_video

CAMERA = """[cam_{n}]
name = "cam_{n}"
size = [64, 48]
matrix = [[50.0, 0.0, 31.5], [0.0, 50.0, 23.5], [0.0, 0.0, 1.0]]
distortions = [0.0, 0.0, 0.0, 0.0, 0.0]
rotation = [0.0, 0.0, 0.0]
translation = [{x}, 0.0, 0.0]
"""


def caliscope(workspace: Path) -> Path:
    """A workspace with one recording of three frames of two cameras, the second one 2 ms late."""
    recording = workspace / "recordings" / "one"
    rows = ["sync_index,cam_id,frame_time"]
    for n in range(2):
        write_video(recording / f"cam_{n}.mp4", [100_000 * k for k in range(3)])
        rows += [f"{k},{n},{500 + 0.1 * k + 0.002 * n:.6f}" for k in range(3)]
    (recording / "timestamps.csv").write_text("\n".join(rows) + "\n")
    (workspace / "camera_array.toml").write_text("".join(CAMERA.format(n=n, x=0.2 * n) for n in range(2)))
    return recording


def test_caliscopes_recordings_and_workspaces_are_recognized(tmp_path: Path) -> None:
    recording = caliscope(tmp_path / "ws")
    said: list[str] = []
    for number, folder in enumerate((recording, tmp_path / "ws")):
        session = import_recording([str(folder)], tmp_path, f"s{number}", ImportOptions(), talk=said.append)
        assert numbers_of(session) == [{"cam_0": k, "cam_1": k} for k in range(3)]
        assert times_of(session, "cam_1")[0] == 500_002_000_000
        calibration = session.calibration()
        assert calibration is not None
        assert calibration.cameras["cam_1"].translation[0] == pytest.approx(0.2)
    assert all("Caliscope" in one for one in said)
    shutil.copytree(recording, tmp_path / "ws" / "recordings" / "two")
    with pytest.raises(BadInputError, match="several recordings: one, two"):
        import_recording([str(tmp_path / "ws")], tmp_path, "s3", ImportOptions())


def test_freemocaps_recordings_are_recognized(tmp_path: Path) -> None:
    folder = tmp_path / "mocap"
    for n in range(2):
        write_video(folder / "synchronized_videos" / f"Camera_00{n}.mp4", [33_333 * k for k in range(3)])
    text = "".join(CAMERA.format(n=n, x=200.0 * n) for n in range(2)) + "[metadata]\nerror = 0.1\n"
    (folder / "mocap_camera_calibration.toml").write_text(text)
    session = import_recording([str(folder)], tmp_path, "s", ImportOptions())
    assert numbers_of(session) == [{"Camera_000": k, "Camera_001": k} for k in range(3)]
    calibration = session.calibration()
    assert calibration is not None
    assert calibration.unit == "m"
    assert calibration.cameras["Camera_001"].translation[0] == pytest.approx(0.2)


@pytest.mark.shared
def test_a_real_caliscope_recording_is_recognized(shared: Path, tmp_path: Path) -> None:
    folder = shared / "footage" / "caliscope_4cam" / "calibration" / "extrinsic"
    session = import_recording([str(folder)], tmp_path, "s", ImportOptions(count=2))
    assert len(session.manifest.images) == 8
    assert session.calibration() is not None


@pytest.mark.parametrize(("to", "tolerance_ns"), [("mp4", 1_000), ("caliscope", 1_000)])
def test_what_was_exported_comes_back_with_its_times(to: str, tolerance_ns: int, tmp_path: Path) -> None:
    sample = Path(__file__).resolve().parents[3] / "sample_sessions" / "crossing"
    assert run(["sessions", "export", str(sample), "--to", to, "--out", str(tmp_path / "out")]) == ExitCode.OK
    times = TimeSource.VIDEO if to == "mp4" else TimeSource.AUTO
    session = import_recording([str(tmp_path / "out")], tmp_path, "s", ImportOptions(times=times))
    assert verify(session) == []
    taken = Session.open(sample).images_by_instant()
    first_ns = min(record.leader_ns for record in taken[0].values())
    zero_ns = min(record.leader_ns for record in session.images_by_instant()[0].values())
    for before, after in zip(taken, session.images_by_instant(), strict=True):
        since = sorted(record.leader_ns - first_ns for record in before.values())
        again = sorted(record.leader_ns - zero_ns for record in after.values())
        assert again == pytest.approx(since, abs=tolerance_ns)
