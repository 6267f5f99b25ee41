"""Recordings that bring their own times: irregular videos, phones, names, EXIF, other programs' folders."""

import shutil
import struct
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_app.cli import run
from capture_app.errors import BadInputError, ExitCode
from capture_app.session.importers import time_source as timeline_module
from capture_app.session.importers.embedded_times import TimeSource, name_time_ns
from capture_app.session.importers.frame_matching import TimedFrame, timeline_by_times
from capture_app.session.importers.recording import ImportOptions, import_recording
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify

from .conftest import jpeg

MS, US = 1_000_000, 1_000
IRREGULAR_US = (0, 33_400, 66_001, 140_000, 166_667, 200_123)


def write_video(path: Path, times_us: Sequence[int], *, first: int = 0) -> Path:
    """A video whose frame n is shown at its own time and is 20 n grey levels bright, n from `first`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w", options={"movie_timescale": "1000000"}) as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.options = {"bf": "2", "crf": "10"}
        stream.time_base = stream.codec_context.time_base = Fraction(1, 1_000_000)
        for number, at_us in enumerate(times_us, first):
            frame = av.VideoFrame.from_ndarray(
                np.full((48, 64, 3), 20 + 20 * number, np.uint8), format="bgr24"
            )
            frame.pts, frame.time_base = at_us, stream.time_base
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def numbers_of(session: Session) -> list[dict[str, int]]:
    """By instant and camera, the number of the frame that an image shows."""
    found = []
    for images in session.images_by_instant():
        pictures = {name: cv2.imread(str(session.image_file(record))) for name, record in images.items()}
        found.append(
            {name: round((float(np.mean(p)) - 20) / 20) for name, p in pictures.items() if p is not None}
        )
    return found


def times_of(session: Session, camera: str) -> list[int]:
    return [record.leader_ns for record in session.manifest.images if record.camera == camera]


def test_irregular_videos_keep_their_own_times(tmp_path: Path) -> None:
    write_video(tmp_path / "rec" / "cam0.mp4", IRREGULAR_US)
    write_video(tmp_path / "rec" / "cam1.mp4", [t + 700 for t in IRREGULAR_US if t != 66_001])
    session = import_recording([str(tmp_path / "rec")], tmp_path, "s", ImportOptions(times=TimeSource.VIDEO))
    assert verify(session) == []
    assert times_of(session, "cam0") == [t * US for t in IRREGULAR_US]
    assert numbers_of(session) == [
        {"cam0": 0, "cam1": 0}, {"cam0": 1, "cam1": 1}, {"cam0": 2}, {"cam0": 3, "cam1": 2},
        {"cam0": 4, "cam1": 3}, {"cam0": 5, "cam1": 4},
    ]  # fmt: skip
    assert [(gone.camera, gone.instant) for gone in session.manifest.missing] == [("cam1", 2)]
    assert session.manifest.sync is not None
    assert session.manifest.sync.spread_ns == (700 * US, 700 * US, 0, 700 * US, 700 * US, 700 * US)


def test_a_frame_that_does_not_decode_shifts_no_other(tmp_path: Path) -> None:
    path = tmp_path / "rec" / "cam0.avi"
    path.parent.mkdir()
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25, (64, 48))
    for number in range(5):
        writer.write(np.full((48, 64, 3), 20 + 20 * number, np.uint8))
    writer.release()
    data = bytearray(path.read_bytes())
    second = data.index(b"\xff\xd8", data.index(b"\xff\xd8") + 2)
    data[second : second + 200] = bytes(200)
    path.write_bytes(data)
    options = ImportOptions(times=TimeSource.VIDEO)
    session = import_recording([str(tmp_path / "rec")], tmp_path, "s", options)
    assert numbers_of(session) == [{"cam0": 0}, {}, {"cam0": 2}, {"cam0": 3}, {"cam0": 4}]
    assert session.manifest.missing[0].reason == "the frame could not be decoded"
    assert times_of(session, "cam0") == [n * 40 * MS for n in (0, 2, 3, 4)]


def test_a_known_offset_brings_phones_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_video(tmp_path / "rec" / "left.mp4", [33_333 * n for n in range(8)])
    write_video(tmp_path / "rec" / "right.mp4", [33_333 * n for n in range(8)])
    arguments = ["sessions", "import", str(tmp_path / "rec"), "--out", str(tmp_path), "--name", "s"]
    assert run([*arguments, "--time-shift-ms", "right=-101"]) == ExitCode.OK
    assert "images of one instant are 1.0 ms apart" in capsys.readouterr().out
    session = Session.open(tmp_path / "s")
    together = [numbers for numbers in numbers_of(session) if len(numbers) == 2]
    assert together == [{"left": n, "right": n + 3} for n in range(5)]


def test_an_offset_moves_numbered_frames_too(tmp_path: Path, make_images: Callable[..., Path]) -> None:
    names = [f"{n}.png" for n in range(6)]
    folder = make_images("left", names).parent
    make_images("right", names)
    options = ImportOptions(fps=10, offsets_ms={"right": -195.0})
    session = import_recording([str(folder)], tmp_path, "s", options)
    pairs = [images for images in session.images_by_instant() if len(images) == 2]
    assert [(of["left"].sequence, of["right"].sequence) for of in pairs] == [(0, 2), (1, 3), (2, 4), (3, 5)]
    assert pairs[0]["right"].leader_ns - pairs[0]["left"].leader_ns == 5 * MS


def test_without_pyav_a_constant_rate_is_assumed_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_video(tmp_path / "rec" / "cam0.mp4", [40_000 * n for n in range(4)])
    monkeypatch.setattr(timeline_module, "has_video_times", lambda: False)
    said: list[str] = []
    options = ImportOptions(times=TimeSource.VIDEO)
    session = import_recording([str(tmp_path / "rec")], tmp_path, "s", options, talk=said.append)
    assert len(said) == 1
    assert "constant" in said[0]
    assert "PyAV" in said[0]
    assert numbers_of(session) == [{"cam0": n} for n in range(4)]


@pytest.mark.parametrize(
    ("name", "time_ns"),
    [
        ("1790000000123456789", 1_790_000_000_123_456_789),
        ("frame_1790000000123456", 1_790_000_000_123_456_000),
        ("1790000000123_left", 1_790_000_000_123_000_000),
        ("IMG_20260131_142530_123", 1_769_869_530_123_000_000),
        ("PXL_20260131_142530123", 1_769_869_530_123_000_000),
        ("2026-01-31T14-25-30.123456", 1_769_869_530_123_456_000),
        ("img_20260131_142530", 1_769_869_530_000_000_000),
    ],
)
def test_times_in_names(name: str, time_ns: int) -> None:
    assert name_time_ns(Path(f"{name}.jpg")) == time_ns


@pytest.mark.parametrize("name", ["frame_000017", "20261331_142530", "holiday"])
def test_names_without_a_time(name: str) -> None:
    with pytest.raises(BadInputError, match=r"has no time|invalid time"):
        name_time_ns(Path(f"{name}.jpg"))


def test_images_are_matched_by_the_times_in_their_names(
    tmp_path: Path, make_images: Callable[..., Path]
) -> None:
    start_ms = 1_790_000_000_000
    folder = make_images("a", [f"{start_ms + 40 * n}.jpg" for n in range(4)]).parent
    make_images("b", [f"{start_ms + 40 * n + 7}.jpg" for n in (0, 1, 3)])
    session = import_recording([str(folder)], tmp_path, "s", ImportOptions(times=TimeSource.NAME))
    assert [len(images) for images in session.images_by_instant()] == [2, 2, 1, 2]
    assert session.images_by_instant()[3]["b"].sequence == 2
    assert session.manifest.sync is not None
    assert max(session.manifest.sync.spread_ns) == 7 * MS


def with_exif(data: bytes, date: str, part: str, order: str = "<") -> bytes:
    """A JPEG with DateTimeOriginal and SubSecTimeOriginal."""
    mark = b"II" if order == "<" else b"MM"
    text = date.encode() + b"\0"
    sub = part.encode().ljust(4, b"\0")[:4]
    first = struct.pack(f"{order}H", 1) + struct.pack(f"{order}HHII", 0x8769, 4, 1, 26) + bytes(4)
    inner = struct.pack(f"{order}H", 2) + struct.pack(f"{order}HHII", 0x9003, 2, len(text), 56)
    inner += struct.pack(f"{order}HHI", 0x9291, 2, len(part) + 1) + sub + bytes(4)
    tiff = mark + struct.pack(f"{order}HI", 42, 8) + first + inner
    body = b"Exif\0\0" + tiff.ljust(56, b"\0") + text
    return data[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + data[2:]


@pytest.mark.parametrize("order", ["<", ">"])
def test_images_are_matched_by_their_exif(tmp_path: Path, order: str) -> None:
    for camera, parts in (("a", ("100", "500", "900")), ("b", ("105", "507", "899"))):
        folder = tmp_path / "rec" / camera
        folder.mkdir(parents=True)
        for number, part in enumerate(parts):
            data = with_exif(jpeg(number), "2026:01:31 14:25:30", part, order)
            (folder / f"DSC_{number}.jpg").write_bytes(data)
    session = import_recording([str(tmp_path / "rec")], tmp_path, "s", ImportOptions(times=TimeSource.EXIF))
    assert times_of(session, "b") == [1_769_869_530_000 * MS + t * MS for t in (105, 507, 899)]
    assert [len(images) for images in session.images_by_instant()] == [2, 2, 2]
    assert session.image_file(session.manifest.images[0]).read_bytes()[:4] == b"\xff\xd8\xff\xe1"


def test_broken_or_absent_exif_says_so(tmp_path: Path) -> None:
    folder = tmp_path / "rec" / "a"
    folder.mkdir(parents=True)
    options = ImportOptions(times=TimeSource.EXIF)
    (folder / "1.jpg").write_bytes(jpeg(0))
    with pytest.raises(BadInputError, match="no EXIF"):
        import_recording([str(tmp_path / "rec")], tmp_path / "out", "s", options)
    good = with_exif(jpeg(0), "2026:01:31 14:25:30", "1")
    for broken in (good.replace(b"II*\0", b"XX*\0"), good.replace(b"II*\0\x08\0", b"II*\0\xff\xff")):
        (folder / "1.jpg").write_bytes(broken)
        with pytest.raises(BadInputError, match="broken"):
            import_recording([str(tmp_path / "rec")], tmp_path / "out", "s", options)
    assert not list((tmp_path / "out").glob("*"))


# Phones


def shot(folder: Path, time: str, leader_ns: int, *, nv21: bool = False) -> None:
    """What libsoftwaresync writes for a shot."""
    folder.mkdir(parents=True, exist_ok=True)
    text = (
        f"leader_sensor_timestamp_ns: {leader_ns}\nlocal_sensor_timestamp_ns: {leader_ns + 5_000_000_000}\n"
    )
    (folder / f"sync_metadata_{time}.txt").write_text(text)
    if not nv21:
        (folder / f"img_{time}.jpg").write_bytes(jpeg(1))
        return
    grey = np.full(16 * 12, 200, np.uint8).tobytes() + np.full(16 * 6, 128, np.uint8).tobytes()
    (folder / f"img_{time}.nv21").write_bytes(grey)
    size = "width: 16\nheight: 12\npixel_format: NV21 (tightly packed)\nluma_buffer_bytes: 192\n"
    (folder / f"nv21_metadata_{time}.txt").write_text(size)


def test_shots_of_libsoftwaresync(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for phone, late_ns in (("pixel_a", 0), ("pixel_b", 80 * US)):
        for number in range(3):
            time = f"20260131_1425{number:02}_123"
            place = tmp_path / "rec" / phone / f"capture_{number}"
            shot(place, time, 10**12 + 2 * 10**9 * number + late_ns, nv21=phone == "pixel_b")
    assert run(["sessions", "import", str(tmp_path / "rec"), "--out", str(tmp_path), "--name", "s"]) == 0
    assert "80 µs apart" in capsys.readouterr().out
    session = Session.open(tmp_path / "s")
    assert verify(session) == []
    first = session.images_by_instant()[0]
    assert session.image_file(first["pixel_a"]).read_bytes() == jpeg(1)
    assert first["pixel_a"].local_ns == 10**12 + 5 * 10**9
    image = cv2.imread(str(session.image_file(first["pixel_b"])))
    assert image is not None
    assert image.shape == (12, 16, 3)
    assert image.mean() > 180
    assert {camera.facts.model for camera in session.manifest.cameras} == {"libsoftwaresync"}


def test_one_shot_of_libsoftwaresync_is_a_session(tmp_path: Path) -> None:
    for phone in ("a", "b"):
        shot(tmp_path / phone, "20260131_142500_123", 10**12)
    paths = [str(tmp_path / phone) for phone in ("a", "b")]
    session = import_recording(paths, tmp_path / "out", "s", ImportOptions())
    assert [len(images) for images in session.images_by_instant()] == [2]


def recsync(folder: Path, times_us: Sequence[int], start_ns: int = 10**13) -> None:
    write_video(folder / "VID_20260131_142530.mp4", times_us)
    lines = "".join(f"{start_ns + t * US}\n" for t in times_us)
    (folder / "VID_20260131_142530.csv").write_text(lines)


def test_videos_of_recsync_are_matched_by_the_leaders_time(tmp_path: Path) -> None:
    times_us = [33_333 * n for n in range(6)]
    recsync(tmp_path / "rec" / "leader", times_us)
    recsync(tmp_path / "rec" / "client", times_us, 10**13 + 66_666 * US + 40 * US)
    table = tmp_path / "rec" / "client" / "VID_20260131_142530.csv"
    table.write_text(table.read_text() + f"{10**13 + 266_706 * US}\n")
    said: list[str] = []
    session = import_recording([str(tmp_path / "rec")], tmp_path, "s", ImportOptions(), talk=said.append)
    assert len(said) == 1
    assert "7 times for 6 frames" in said[0]
    together = [numbers for numbers in numbers_of(session) if len(numbers) == 2]
    assert together == [{"client": n, "leader": n + 2} for n in range(4)]
    assert session.manifest.sync is not None
    assert max(session.manifest.sync.spread_ns) == 40 * US
    assert times_of(session, "leader")[0] == 10**13


def remake(folder: Path, change: Callable[[Path], Any]) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    change(folder)


def swap_lines(folder: Path) -> None:
    recsync(folder, [0, 33_333, 66_666])
    (folder / "VID_20260131_142530.csv").write_text("1000\n3000\n2000\n")


BROKEN: dict[str, tuple[Callable[[Path], Any], str]] = {
    "backwards": (swap_lines, "times go backwards: frame 2"),
    "no number": (
        lambda f: (recsync(f, [0, 33_333]), (f / "VID_20260131_142530.csv").write_text("1\nsoon\n")),
        "line 2",
    ),
    "empty table": (
        lambda f: (recsync(f, [0, 33_333]), (f / "VID_20260131_142530.csv").write_text("\n")), "no times",
    ),
    "two recordings": (
        lambda f: (
            recsync(f, [0, 33_333]),
            shutil.copy(f / "VID_20260131_142530.mp4", f / "VID_2.mp4"),
            (f / "VID_2.csv").write_text("1\n2\n"),
        ),
        "several recordings",
    ),
    "not a video": (
        lambda f: (recsync(f, [0, 33_333]), (f / "VID_20260131_142530.mp4").write_bytes(b"no video")),
        "not a video that can be decoded",
    ),
    "no leader time": (
        lambda f: (shot(f, "x", 1), (f / "sync_metadata_x.txt").write_text("local_sensor_timestamp_ns: 1\n")),
        "no leader_sensor_timestamp_ns",
    ),
    "no image": (lambda f: (shot(f, "x", 1), (f / "img_x.jpg").unlink()), "no image"),
    "cut nv21": (
        lambda f: (shot(f, "x", 1, nv21=True), (f / "img_x.nv21").write_bytes(b"123")),
        "16x12 pixels of NV21",
    ),
    "one time twice": (lambda f: (shot(f, "x", 1), shot(f, "y", 1)), "same time"),
}  # fmt: skip


@pytest.mark.parametrize("broken", BROKEN)
def test_broken_recordings_of_phones_say_why_and_leave_nothing(tmp_path: Path, broken: str) -> None:
    make, reason = BROKEN[broken]
    (tmp_path / "phone").mkdir()
    make(tmp_path / "phone")
    with pytest.raises(BadInputError, match=reason):
        import_recording([str(tmp_path / "phone")], tmp_path / "out", "s", ImportOptions())
    assert not list((tmp_path / "out").glob("*"))


# Other programs' folders


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


# What cannot be


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--time-shift-ms", "cam9=1"], "cam9, which the recording lacks"),
        (["--time-shift-ms", "cam0"], "not CAMERA=MS"),
        (["--time-shift-ms", "cam0=inf"], "not CAMERA=MS"),
        (["--times", "name"], "not a folder of images"),
        (["--times", "video", "--fps", "30"], "either the rate"),
        ([], "--times video"),
    ],
)
def test_impossible_times_say_why(
    tmp_path: Path, arguments: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_video(tmp_path / "rec" / "cam0.mp4", [0, 40_000])
    out = ["--out", str(tmp_path / "out")]
    assert run(["sessions", "import", str(tmp_path / "rec"), *out, *arguments]) == ExitCode.BAD_INPUT
    error = capsys.readouterr().err
    assert reason in error
    assert len(error.splitlines()) == 1
    assert not list((tmp_path / "out").glob("*"))


def test_a_table_whose_times_go_backwards_is_refused(
    tmp_path: Path, make_images: Callable[..., Path]
) -> None:
    folder = make_images("a", ["0.jpg", "1.jpg", "2.jpg"])
    table = tmp_path / "times.csv"
    table.write_text("camera,frame,time_ms\na,0,0\na,1,80\na,2,40\n")
    with pytest.raises(BadInputError, match="times go backwards: frame 2 is 40 ms before frame 1"):
        import_recording([f"a={folder}"], tmp_path / "out", "s", ImportOptions(timestamps=table))


@given(
    st.lists(
        st.lists(st.integers(1, 200), min_size=1, max_size=12).map(
            lambda steps: [sum(steps[: n + 1]) * MS for n in range(len(steps))]
        ),
        min_size=1,
        max_size=4,
    )
)
def test_every_frame_is_used_at_most_once_and_near_its_instants_first(times: list[list[int]]) -> None:
    cameras = {
        f"c{number}": [TimedFrame(index, at_ns) for index, at_ns in enumerate(of)]
        for number, of in enumerate(times)
    }
    timeline = timeline_by_times("x", cameras)
    used = [(name, frame.index) for instant in timeline.instants for name, frame in instant.frames.items()]
    assert len(set(used)) == len(used)
    lead = max(cameras, key=lambda name: len(cameras[name]))
    assert sum(name == lead for name, _ in used) == len(cameras[lead])
    for instant in timeline.instants:
        of = [frame.leader_ns for frame in instant.frames.values()]
        assert min(of) <= instant.leader_ns <= max(of)
        assert max(of) - min(of) <= timeline.period_ns
        assert set(instant.frames) | set(instant.why_missing) == set(cameras)
    for name, frames in cameras.items():
        indices = [i.frames[name].index for i in timeline.instants if name in i.frames]
        assert len(indices) <= len(frames)


def test_a_phone_held_upright_gives_upright_pictures_either_way(tmp_path: Path) -> None:
    """The same as OpenCV makes of a video whose track says that it is turned."""
    path = write_video(tmp_path / "rec" / "cam0.mp4", [0, 40_000])
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        picture = np.zeros((48, 64, 3), np.uint8)
        picture[:24, :32] = 255  # only the top left is bright
        for _ in range(2):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="bgr24")))
        container.mux(stream.encode(None))
    data = path.read_bytes()
    place = data.index(struct.pack(">iiiii", 1 << 16, 0, 0, 0, 1 << 16), data.index(b"tkhd"))
    turned = struct.pack(">iiiii", 0, 1 << 16, 0, -(1 << 16), 0)
    path.write_bytes(data[:place] + turned + data[place + len(turned) :])
    shown = []
    for name, options in (("own", ImportOptions(times=TimeSource.VIDEO)), ("rate", ImportOptions(fps=25))):
        session = import_recording([str(tmp_path / "rec")], tmp_path, name, options)
        facts = session.manifest.cameras[0].facts
        assert (facts.width, facts.height) == (48, 64)
        image = cv2.imread(str(session.image_file(session.manifest.images[0])))
        assert image is not None
        shown.append(image)
    assert np.abs(shown[0].astype(int) - shown[1]).max() < 30


@pytest.mark.parametrize(("to", "tolerance_ns"), [("mp4", 1_000), ("caliscope", 1_000)])
def test_what_was_exported_comes_back_with_its_times(to: str, tolerance_ns: int, tmp_path: Path) -> None:
    sample = Path(__file__).resolve().parents[2] / "sample_sessions" / "crossing"
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
