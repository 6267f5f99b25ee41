"""Recordings of phones become sessions: libsoftwaresync, RecSync, and phones held upright."""

import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from capture_app.cli import run
from capture_app.common.errors import BadInputError, ExitCode
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.imported import import_one
from tests.unit.companions.importing.numbered_video import US, numbers_of, times_of, write_video
from tests.unit.session.conftest import jpeg


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
    session = import_one(paths, tmp_path / "out", "s", ImportOptions())
    assert [len(images) for images in session.images_by_instant()] == [2]


VIDEO, TABLE = "VID/VID_20260131_142530.mp4", "20260131_142530.csv"


def recsync(
    folder: Path, times_us: Sequence[int], start_ns: int = 10**13, video: str = VIDEO, table: str = TABLE
) -> None:
    """What RecSync leaves in RecSync/ on a phone: MainActivity.java, startVideo."""
    write_video(folder / video, times_us)
    lines = "".join(f"{start_ns + t * US}\n" for t in times_us)
    (folder / table).write_text(lines)


def test_videos_of_recsync_are_matched_by_the_leaders_time(tmp_path: Path) -> None:
    times_us = [33_333 * n for n in range(6)]
    recsync(tmp_path / "rec" / "leader", times_us)
    recsync(tmp_path / "rec" / "client", times_us, 10**13 + 66_666 * US + 40 * US)
    table = tmp_path / "rec" / "client" / TABLE
    table.write_text(table.read_text() + f"{10**13 + 266_706 * US}\n")
    said: list[str] = []
    session = import_one([str(tmp_path / "rec")], tmp_path, "s", ImportOptions(), talk=said.append)
    assert [line for line in said if "equal files" not in line] == [said[0]]
    assert "7 times for 6 frames" in said[0]
    together = [numbers for numbers in numbers_of(session) if len(numbers) == 2]
    assert together == [{"client": n, "leader": n + 2} for n in range(4)]
    assert session.manifest.sync is not None
    assert max(session.manifest.sync.spread_ns) == 40 * US
    assert times_of(session, "leader")[0] == 10**13


LAYOUTS: dict[str, tuple[str, str, str]] = {
    "RecSync, a folder copied from each phone": ("RecSync/", VIDEO, TABLE),
    "RecSync's first version": ("TMP_MROB/", VIDEO, TABLE),
    "what is in that folder": ("", VIDEO, TABLE),
    "gathered by hand": ("", "VID_20260131_142530.mp4", "VID_20260131_142530.csv"),
    "RecSyncNG on the phone": ("RecSync/", "VID/clap_20260131_142530.mp4", "clap_20260131_142530.csv"),
    # file_server.py: PREFIX/CLIENT/, the client's id is Settings.Secure.ANDROID_ID, 16 hexadecimal digits.
    "RecSyncNG's file server": ("", "clap_20260131_142530.mp4", "clap_20260131_142530.csv"),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layouts_of_recsync(tmp_path: Path, layout: str) -> None:
    inside, video, table = LAYOUTS[layout]
    for n, phone in enumerate(("3f2a9c0d1b7e4a56", "9b8c7d6e5f4a3b2c")):
        folder = tmp_path / "clap" / phone / inside
        recsync(folder, [33_333 * k for k in range(4)], 10**13 + 50 * US * n, video, table)
        # createRecorderSurface of RecSync leaves an empty video behind whenever the camera is opened.
        (folder / video).with_name("VID_20260131_142501.mp4").write_bytes(b"")
    session = import_one([str(tmp_path / "clap")], tmp_path, "s", ImportOptions())
    assert verify(session) == []
    assert numbers_of(session) == [{"3f2a9c0d1b7e4a56": k, "9b8c7d6e5f4a3b2c": k} for k in range(4)]
    assert times_of(session, "9b8c7d6e5f4a3b2c")[0] == 10**13 + 50 * US
    assert session.manifest.sync is not None
    assert set(session.manifest.sync.spread_ns) == {50 * US}


def test_what_recsyncngs_postprocessing_made(tmp_path: Path) -> None:
    """PostProcessVideos.py: CLIENT.mp4 and CLIENT.csv with a heading; frames that it put in are black."""
    folder = tmp_path / "out"
    for n, phone in enumerate(("3f2a9c0d1b7e4a56", "9b8c7d6e5f4a3b2c")):
        write_video(folder / f"{phone}.mp4", [33_333 * k for k in range(4)])
        made = ["Original", "Original", "Generated" if n else "Original", "Original"]
        rows = [f"{10**13 + 33_333 * US * k + n},{made[k]}" for k in range(4)]
        (folder / f"{phone}.csv").write_text("\n".join(["timestamp,Generated", *rows, ""]))
    said: list[str] = []
    session = import_one([str(folder)], tmp_path, "s", ImportOptions(), talk=said.append)
    numbers = [sorted(of.values()) for of in numbers_of(session)]
    assert numbers == [[0, 0], [1, 1], [2], [3, 3]]
    assert ["1 of 4 frames are fillers" in one for one in said].count(True) == 1


def test_one_of_several_recordings_on_each_phone(tmp_path: Path) -> None:
    for phone in ("a", "b"):
        for k, take in enumerate(("clap", "jump")):
            name = f"{take}_20260131_14253{k}"
            folder = tmp_path / "rec" / phone / "RecSync"
            recsync(folder, [0, 33_333], 10**13 * (k + 1), f"VID/{name}.mp4", f"{name}.csv")
    out = ["--out", str(tmp_path), "--name", "s"]
    assert run(["sessions", "import", str(tmp_path / "rec"), *out]) == ExitCode.BAD_INPUT
    assert run(["sessions", "import", str(tmp_path / "rec"), *out, "--recording", "jump"]) == ExitCode.OK
    assert times_of(Session.open(tmp_path / "s"), "a")[0] == 2 * 10**13
    with pytest.raises(BadInputError, match="0 recordings named like sing"):
        import_one([str(tmp_path / "rec")], tmp_path, "t", ImportOptions(recording="sing"))


def video(table: str) -> Callable[[Path], Any]:
    """RecSync's recording of three frames with this table of times."""
    return lambda folder: (recsync(folder, [0, 33_333, 66_666]), (folder / TABLE).write_text(table))


def spoil(name: str, data: bytes, *, nv21: bool = False) -> Callable[[Path], Any]:
    """A shot, called x, of which one file is other than it should be."""
    return lambda folder: (shot(folder, "x", 1, nv21=nv21), (folder / name).write_bytes(data))


def second_video(folder: Path) -> None:
    recsync(folder, [0, 33_333])
    recsync(folder, [0, 33_333], video="VID/VID_20260131_150000.mp4", table="20260131_150000.csv")


BROKEN: dict[str, tuple[Callable[[Path], Any], str]] = {
    "backwards": (video("1000\n3000\n2000\n"), "times go backwards: frame 2"),
    "no number": (video("1\nsoon\n"), "line 2"),
    "empty table": (video("\n"), "no times"),
    "two recordings": (second_video, "several recordings"),
    "not a video": (
        lambda f: (recsync(f, [0, 33_333]), (f / VIDEO).write_bytes(b"no video")),
        "not a video that can be decoded",
    ),
    "no leader time": (
        spoil("sync_metadata_x.txt", b"local_sensor_timestamp_ns: 1\n"), "no leader_sensor_timestamp_ns",
    ),
    "no image": (lambda f: (shot(f, "x", 1), (f / "img_x.jpg").unlink()), "no image"),
    "cut nv21": (spoil("img_x.nv21", b"123", nv21=True), "16x12 pixels of NV21"),
    "one time twice": (lambda f: (shot(f, "x", 1), shot(f, "y", 1)), "same time"),
}  # fmt: skip


@pytest.mark.parametrize("broken", BROKEN)
def test_broken_recordings_of_phones_say_why_and_leave_nothing(tmp_path: Path, broken: str) -> None:
    make, reason = BROKEN[broken]
    (tmp_path / "phone").mkdir()
    make(tmp_path / "phone")
    with pytest.raises(BadInputError, match=reason):
        import_one([str(tmp_path / "phone")], tmp_path / "out", "s", ImportOptions())
    assert not list((tmp_path / "out").glob("*"))


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
    for name, options in (("own", ImportOptions(times="video")), ("rate", ImportOptions(fps=25))):
        session = import_one([str(tmp_path / "rec")], tmp_path, name, options)
        facts = session.manifest.cameras[0].facts
        assert (facts.width, facts.height) == (48, 64)
        image = cv2.imread(str(session.image_file(session.manifest.images[0])))
        assert image is not None
        shown.append(image)
    assert np.abs(shown[0].astype(int) - shown[1]).max() < 30
