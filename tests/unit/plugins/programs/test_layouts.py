"""Folders of other programs are recognized, and our own exports come back with their times."""

import pickle
import shutil
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from capture_app.cli import run
from capture_app.common.errors import BadInputError, ExitCode
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.companions.importing.recording import import_found
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.imported import import_one
from tests.unit.companions.importing.numbered_video import numbers_of, times_of, write_video

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
        session = import_one([str(folder)], tmp_path, f"s{number}", ImportOptions(), talk=said.append)
        assert numbers_of(session) == [{"cam_0": k, "cam_1": k} for k in range(3)]
        assert times_of(session, "cam_1")[0] == 500_002_000_000
        calibration = session.calibration()
        assert calibration is not None
        assert calibration.cameras["cam_1"].translation[0] == pytest.approx(0.2)
    assert sum("Caliscope" in line for line in said) == 2
    assert "cameras of timestamps.csv: cam_0 = 0, cam_1 = 1" in said
    no_unit = "camera_array.toml states no unit of its lengths: m is assumed; --unit mm says otherwise"
    assert said.count(no_unit) == 2
    shutil.copytree(recording, tmp_path / "ws" / "recordings" / "two")
    both = import_found([str(tmp_path / "ws")], tmp_path, "s3", ImportOptions(), talk=said.append)
    assert [session.folder.name for session in both] == ["s3-one", "s3-two"]
    assert f"{tmp_path / 'ws'} has 2 recordings, a session each: one, two" in said
    with pytest.raises(BadInputError, match="no recording three"):
        import_one([str(tmp_path / "ws")], tmp_path, "s4", ImportOptions(recording="three"))


def test_freemocaps_recordings_are_recognized(tmp_path: Path) -> None:
    folder = tmp_path / "mocap"
    for n in range(2):
        write_video(folder / "synchronized_videos" / f"Camera_00{n}.mp4", [33_333 * k for k in range(3)])
    text = "".join(CAMERA.format(n=n, x=200.0 * n) for n in range(2)) + "[metadata]\nerror = 0.1\n"
    (folder / "mocap_camera_calibration.toml").write_text(text)
    session = import_one([str(folder)], tmp_path, "s", ImportOptions())
    assert numbers_of(session) == [{"Camera_000": k, "Camera_001": k} for k in range(3)]
    calibration = session.calibration()
    assert calibration is not None
    assert calibration.unit == "m"
    assert calibration.cameras["Camera_001"].translation[0] == pytest.approx(0.2)


SKELLYCAM = (
    "recording_frame_number,connection_frame_number,timestamp.from_recording_start.sec,"
    "timestamp.utc.seconds,timestamp.local.iso8601,timestamp.perf_counter_ns.ns"
)
"""The first columns of skellycam's CAMERA_TIMESTAMPS_CSV_ROW_DTYPE, which np.savetxt writes."""


@pytest.mark.parametrize("videos", ["synchronized_videos", "videos/synchronized"])
def test_freemocap_2(tmp_path: Path, videos: str) -> None:
    """Names of skellycam's recording_info.py and parse_video_filename.py; the calibration of freemocap's
    calibration_models.py, dump_anipose_toml, whose cameras are named by their ids."""
    folder = tmp_path / "wave"
    start_ns, period_ns = 123_456_789_012_345, 33_333_333
    toml = ""
    for n in range(2):
        write_video(folder / videos / f"wave.id-{n}.idx-{n}.mp4", [33_333 * k for k in range(3)])
        rows = [SKELLYCAM]
        for k in range(3):
            grabbed_ns = start_ns + k * period_ns + 1_500_000 * n
            text = "2026-01-31T14:25:30.123456+01:00"
            rows.append(f"{k},{k + 900},{k / 30},1769865930.1,{text},{grabbed_ns}")
        table = folder / videos / "timestamps" / "camera_timestamps" / f"wave.camera{n}.timestamps.csv"
        table.parent.mkdir(parents=True, exist_ok=True)
        table.write_text("\n".join([*rows, ""]))
        toml += CAMERA.format(n=n, x=200.0 * n).replace(f"cam_{n}", str(n))
        toml += (
            f"world_orientation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nworld_position = [{-200 * n}, 0, 0]\n"
        )
    (folder / "wave_camera_calibration.toml").write_text(toml + "[metadata]\nreprojection_error_px = 0.1\n")
    session = import_one([str(folder)], tmp_path, "s", ImportOptions())
    assert verify(session) == []
    assert numbers_of(session) == [{"0": k, "1": k} for k in range(3)]
    assert times_of(session, "1") == [start_ns + k * period_ns + 1_500_000 for k in range(3)]
    assert session.manifest.sync is not None
    assert set(session.manifest.sync.spread_ns) == {1_500_000}
    calibration = session.calibration()
    assert calibration is not None
    assert calibration.cameras["1"].translation[0] == pytest.approx(0.2)
    table.write_text("recording_frame_number\n0\n")
    with pytest.raises(BadInputError, match="no whole numbers"):
        import_one([str(folder)], tmp_path, "t", ImportOptions())


def opencap(folder: Path, trials: dict[str, tuple[str, ...]]) -> None:
    """A download as opencap-api's zipsession.py packs it."""
    for n in range(2):
        camera = folder / "Videos" / f"Cam{n}"
        for trial, endings in trials.items():
            for ending in endings:
                write_video(
                    camera / "InputMedia" / trial / f"{trial}{ending}", [16_667 * k for k in range(3)]
                )
        content = {
            "distortion": np.zeros((1, 5)),
            "intrinsicMat": np.array([[50.0, 0, 31.5], [0, 50, 23.5], [0, 0, 1]]),
            "imageSize": np.array([[48.0], [64.0]]),
            "rotation": np.eye(3),
            "translation": np.array([[200.0 * n], [0], [2000]]),
        }
        (camera / "cameraIntrinsicsExtrinsics.pickle").write_bytes(pickle.dumps(content))
    (folder / "Videos" / "mappingCamDevice.pickle").write_bytes(pickle.dumps({"A1B2": 0, "C3D4": 1}))
    (folder / "sessionMetadata.yml").write_text("mass_kg: 70\n")


def test_opencaps_trials(tmp_path: Path) -> None:
    folder = tmp_path / "OpenCapData_1"
    opencap(folder, {"neutral": (".mov", "_sync.mp4"), "walk1": (".mov",)})
    with pytest.raises(BadInputError, match="no recording run"):
        import_one([str(folder)], tmp_path, "s", ImportOptions(recording="run"))
    session = import_one([str(folder)], tmp_path, "s", ImportOptions(recording="neutral"))
    assert numbers_of(session) == [{"Cam0": k, "Cam1": k} for k in range(3)]
    calibration = session.calibration()
    assert calibration is not None
    assert (calibration.unit, calibration.cameras["Cam1"].translation) == ("m", pytest.approx((0.2, 0, 2)))
    said: list[str] = []
    options = ImportOptions(recording="walk1", times="video")
    import_one([str(folder)], tmp_path, "walk", options, talk=said.append)
    assert any("not aligned by OpenCap" in one for one in said)


def test_each_recording_of_a_folder_becomes_a_session(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    opencap(tmp_path / "OpenCapData_1", {"neutral": (".mov", "_sync.mp4"), "walk1": (".mov",)})
    assert run(["sessions", "import", str(tmp_path / "OpenCapData_1"), "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr()
    assert "not aligned by OpenCap" in printed.err
    for trial, known in (("neutral", True), ("walk1", False)):
        session = Session.open(tmp_path / "out" / f"OpenCapData_1-{trial}")
        times = session.manifest.burst.common_times
        assert times is not None
        assert times.unknown != known
        assert session.calibration() is not None


@pytest.mark.parametrize("kind", ["videos", "images"])
def test_easymocaps_sequences_are_recognized(
    tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The folders of EasyMocap's documentation (doc/quickstart.md), with a calibration."""
    root = tmp_path / "seq"
    for n in range(2):
        if kind == "videos":
            write_video(root / "videos" / f"{n + 1}.mp4", [20_000 * k for k in range(3)])
        for k in range(3):
            (root / "images" / f"{n + 1}").mkdir(parents=True, exist_ok=True)
            picture = np.full((48, 64, 3), 20 + 20 * k, np.uint8)
            cv2.imwrite(str(root / "images" / f"{n + 1}" / f"{k:06d}.jpg"), picture)
    intrinsics = cv2.FileStorage(str(root / "intri.yml"), cv2.FILE_STORAGE_WRITE)
    extrinsics = cv2.FileStorage(str(root / "extri.yml"), cv2.FILE_STORAGE_WRITE)
    for storage in (intrinsics, extrinsics):
        storage.startWriteStruct("names", cv2.FileNode_SEQ)
        for n in range(2):
            storage.write("", str(n + 1))
        storage.endWriteStruct()
    for n in range(2):
        intrinsics.write(f"K_{n + 1}", np.array([[50.0, 0, 31.5], [0, 50, 23.5], [0, 0, 1]]))
        intrinsics.write(f"dist_{n + 1}", np.zeros((1, 5)))
        extrinsics.write(f"R_{n + 1}", np.zeros((3, 1)))
        extrinsics.write(f"T_{n + 1}", np.array([[0.2 * n], [0.0], [0.0]]))
    for storage in (intrinsics, extrinsics):
        storage.release()
    assert run(["sessions", "import", str(root), "--out", str(tmp_path / "out")]) == ExitCode.OK
    session = Session.open(tmp_path / "out" / "seq")
    assert numbers_of(session) == [{"1": k, "2": k} for k in range(3)]
    assert kind == "videos" or session.manifest.burst.period_ns == 33_333_333
    assert session.calibration() is not None
    said = capsys.readouterr().err
    assert ("30 frames a second are assumed" in said) == (kind == "images")
    # Videos of three frames have no two that are 66 ms apart.
    step = "capture-app sessions sheet" if kind == "videos" else "reconstruct compare"
    assert f"next: {step} {session.folder}" in said


@pytest.mark.parametrize("suffix", [".h264", ".mts", ".m2ts", ".mpg", ".mjpeg"])
def test_videos_that_do_not_count_their_frames(tmp_path: Path, suffix: str) -> None:
    """A raw stream of a Raspberry Pi (rpicam-vid -o x.h264), AVCHD of camcorders (.mts), and older ones."""
    formats = {".h264": "h264", ".mts": "mpegts", ".m2ts": "mpegts", ".mpg": "mpeg", ".mjpeg": "mjpeg"}
    codec = {".mpg": "mpeg2video", ".mjpeg": "mjpeg"}.get(suffix, "libx264")
    for n in range(2):
        path = tmp_path / "rec" / f"cam{n}{suffix}"
        path.parent.mkdir(exist_ok=True)
        with av.open(str(path), "w", format=formats[suffix]) as container:
            stream: Any = container.add_stream(codec, rate=25)
            stream.width, stream.height = 64, 48
            stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
            for k in range(7):
                picture = np.full((48, 64, 3), 20 + 20 * k, np.uint8)
                container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="bgr24")))
            container.mux(stream.encode(None))
    session = import_one([str(tmp_path / "rec")], tmp_path, "s", ImportOptions(fps=25))
    assert numbers_of(session) == [{"cam0": k, "cam1": k} for k in range(7)]
    assert session.manifest.missing == ()


@pytest.mark.shared
def test_a_real_caliscope_recording_is_recognized(shared: Path, tmp_path: Path) -> None:
    folder = shared / "footage" / "caliscope_4cam" / "calibration" / "extrinsic"
    session = import_one([str(folder)], tmp_path, "s", ImportOptions(count=2))
    assert len(session.manifest.images) == 8
    assert session.calibration() is not None
