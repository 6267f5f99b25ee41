"""Recordings become sessions: small ones made here, and real ones whose geometry must come out right."""

import csv
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from capture_app.common.errors import BadInputError
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.format.calibration import CameraCalibration
from capture_app.session.importing import recording_sources
from capture_app.session.importing.frame_matching import TimedFrame, at_slowest_rate, timeline_by_times
from capture_app.session.reading.decoding import encode_image
from capture_app.session.reading.verify import verify
from tests.imported import import_one

Array = NDArray[np.float64]
MakeImages = Callable[..., Path]


@pytest.fixture
def video(tmp_path: Path) -> Path:
    """A video of ten frames, each brighter than the one before."""
    folder = tmp_path / "videos"
    folder.mkdir()
    for name in ("cam0", "cam1"):
        writer = cv2.VideoWriter(str(folder / f"{name}.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 30, (64, 48))
        for frame in range(10):
            writer.write(np.full((48, 64, 3), 20 * frame + 10, np.uint8))
        writer.release()
    return folder


def test_folders_of_images_keep_their_bytes(make_images: MakeImages, tmp_path: Path) -> None:
    left = make_images("left", ["9.png", "10.png", "12.png"])
    right = make_images("right", ["frame_0009.png", "frame_0010.png", "frame_0011.png"])
    session = import_one(
        [str(left.parent)], tmp_path / "out", "rec", ImportOptions(fps=50, uncertainty_ms=1.5, note="hello")
    )
    assert verify(session) == []
    manifest = session.manifest
    assert (manifest.origin, manifest.note) == ("imported", "hello")
    assert [camera.name for camera in manifest.cameras] == ["left", "right"]
    assert manifest.burst.instants_ns == (0, 20_000_000, 40_000_000, 60_000_000)
    assert [(gone.camera, gone.instant) for gone in manifest.missing] == [("left", 2), ("right", 3)]
    instants = session.images_by_instant()
    assert session.image_file(instants[1]["right"]).read_bytes() == (right / "frame_0010.png").read_bytes()
    assert session.image_file(instants[3]["left"]).name == "000003.png"
    assert instants[3]["left"].uncertainty_ns == 1_500_000
    assert instants[3]["left"].sequence == 2
    assert session.camera("left").clock is None


def test_videos_give_the_frames_asked_for(video: Path, tmp_path: Path) -> None:
    options = ImportOptions(fps=30, start=2, every=3, count=2, png=True)
    session = import_one([str(video)], tmp_path, "rec", options)
    assert session.manifest.burst.instants_ns == (66_666_667, 166_666_667)
    for instant, bright in zip(session.images_by_instant(), (50, 110), strict=True):
        for record in instant.values():
            image = cv2.imread(str(session.image_file(record)))
            assert image is not None
            assert abs(image.mean() - bright) < 3
            assert record.path.endswith(".png")


def test_an_unreadable_end_of_a_video_is_missing(video: Path, tmp_path: Path) -> None:
    path = video / "cam1.avi"
    data = path.read_bytes()
    start = data.rindex(b"00dc", 0, data.rindex(b"idx1"))
    path.write_bytes(data[: start + 8] + b"\0" * (len(data) - start - 8))
    session = import_one([str(video)], tmp_path, "rec", ImportOptions(fps=30))
    gone = session.manifest.missing
    assert gone
    assert {record.camera for record in gone} == {"cam1"}
    assert verify(session) == []


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (ImportOptions(fps=30, timestamps=[("", Path("x"))]), "--fps, or a table"),
        (ImportOptions(timestamps=[("", Path("nowhere.csv"))]), "nowhere.csv"),
        (ImportOptions(fps=30, start=10), "10 instants, none from 10"),
        (ImportOptions(fps=30, calibration=("nowhere.npz",)), "no calibration at nowhere"),
    ],
)
def test_bad_options_say_why_and_leave_nothing(
    video: Path, tmp_path: Path, options: ImportOptions, reason: str
) -> None:
    with pytest.raises(BadInputError, match=reason):
        import_one([str(video)], tmp_path / "out", "rec", options)
    assert not (tmp_path / "out" / "rec").exists()


def test_a_calibration_of_another_size_is_refused_before_the_frames_are_decoded(
    video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "stereo.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    camera, straight = np.diag([60.0, 60.0, 1.0]), np.zeros(5)
    for key in ("M1", "M2", "D1", "D2", "R", "T"):
        storage.write(key, {"M": camera, "D": straight, "R": np.eye(3), "T": np.ones(3)}[key[0]])
    storage.write("image_width", 64)
    storage.write("image_height", 64)
    storage.release()
    decoded: list[str] = []

    def encode(image: NDArray[np.uint8], suffix: str) -> bytes:
        decoded.append(suffix)
        return encode_image(image, suffix)

    monkeypatch.setattr(recording_sources, "encode_image", encode)
    folder = tmp_path / "two"
    folder.mkdir()
    for number, name in enumerate(("left", "right")):
        shutil.copy(sorted(video.glob("*.avi"))[number], folder / f"{name}.avi")
    with pytest.raises(BadInputError, match="64x64 pixels, its images are 64x48"):
        import_one([str(folder)], tmp_path, "rec", ImportOptions(fps=30, calibration=(str(path),)))
    assert len(decoded) == 2, "one frame of each camera"


def test_bad_recordings_say_why_and_leave_nothing(make_images: MakeImages, tmp_path: Path) -> None:
    folder = make_images("left", ["0.png", "1.png"])
    out, options = tmp_path / "out", ImportOptions(fps=30)

    def refuse(reason: str, *paths: str) -> None:
        with pytest.raises(BadInputError, match=reason):
            import_one(list(paths), out, "rec", options)
        assert not (out / "rec").exists()

    refuse("nothing at", str(tmp_path / "nowhere"))
    refuse("2 images, whose names tell no cameras apart", str(folder))
    refuse("two cameras are named left", str(folder.parent), f"left={folder}")
    (tmp_path / "empty").mkdir()
    refuse("no images in", f"a={tmp_path / 'empty'}")
    (folder / "1.png").write_bytes(b"not an image")
    refuse(r"1\.png is not an image", str(folder.parent))
    make_images("other", ["0.png"], width=20)
    (folder / "1.png").write_bytes((folder.parent / "other" / "0.png").read_bytes())
    refuse("has images of", f"left={folder}")
    (folder / "2.jpg").write_bytes(b"x")
    refuse("mixes", f"left={folder}")
    (tmp_path / "a.mp4").write_bytes(b"not a video")
    refuse("not a video", str(tmp_path / "a.mp4"))


def parts(camera: CameraCalibration) -> tuple[Array, Array, Array, Array]:
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    return matrix, np.array(camera.distortion), np.array(camera.rotation), np.array(camera.translation)


def project(camera: CameraCalibration, points: Array) -> Array:
    matrix, distortion, rotation, translation = parts(camera)
    return cv2.projectPoints(points, cv2.Rodrigues(rotation)[0], translation, matrix, distortion)[0][:, 0]


@pytest.mark.shared
def test_caliscope_points_project_where_they_were_seen(shared: Path, tmp_path: Path) -> None:
    folder = shared / "footage" / "caliscope_4cam"
    recording = folder / "calibration" / "extrinsic"
    options = ImportOptions(
        timestamps=[("", recording / "timestamps.csv")],
        count=3,
        calibration=(str(folder / "camera_array.toml"),),
    )
    session = import_one([str(recording)], tmp_path, "board", options)
    assert len(session.manifest.images) == 12
    assert session.manifest.burst.period_ns == pytest.approx(1e9 / 6, rel=0.01)
    first = session.images_by_instant()[0]
    assert first["cam_3"].leader_ns - first["cam_2"].leader_ns == 10_619_350
    calibration = session.calibration()
    assert calibration is not None
    with (recording / "stereotriangulated_points.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["pair"] == "(0, 1)"]
    points = np.array([[float(row[key]) for key in ("x_pos", "y_pos", "z_pos")] for row in rows])
    for side, name in (("A", "cam_0"), ("B", "cam_1")):
        seen = np.array([[float(row[f"x_{side}"]), float(row[f"y_{side}"])] for row in rows])
        away = np.linalg.norm(project(calibration.cameras[name], points) - seen, axis=1)
        assert np.median(away) < 1


def test_what_the_slowest_camera_lost_is_missing() -> None:
    slow = [TimedFrame(n, n * 40_000_000) for n in range(20) if n != 7]
    fast = [TimedFrame(n, n * 16_683_333 + 3_000_000) for n in range(47)]
    said: list[str] = []
    timeline = at_slowest_rate(timeline_by_times("it", {"slow": slow, "fast": fast}), said.append)
    assert [sorted(one.frames) for one in timeline.instants] == [
        ["fast"] if n == 7 else ["fast", "slow"] for n in range(20)
    ]
    assert timeline.instants[7].leader_ns == pytest.approx(280_000_000, abs=12_000_000)
    assert timeline.period_ns == 40_000_000
    assert said == [
        "fast 59.94 frames a second, slow 25: the nearest are taken, 27 instants between are left out"
    ]


def test_rates_that_are_nearly_one_lose_nothing() -> None:
    cameras = {
        name: [TimedFrame(n, round(n * 1e9 / fps)) for n in range(50)]
        for name, fps in (("a", 30), ("b", 29.97), ("c", 28))
    }
    timeline = timeline_by_times("it", cameras)
    assert at_slowest_rate(timeline, pytest.fail) is timeline
