"""Recordings that bring their own times: irregular videos, phones, names, EXIF, other programs' folders."""

import struct
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_app.cli import run
from capture_app.common.errors import BadInputError, ExitCode
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.session.importing.frame_matching import TimedFrame, at_slowest_rate, timeline_by_times
from capture_app.session.importing.recording_sources import name_time_ns
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.imported import import_one
from tests.unit.companions.importing.numbered_video import (
    IRREGULAR_US,
    MS,
    US,
    numbers_of,
    times_of,
    write_video,
)
from tests.unit.session.conftest import jpeg


def test_irregular_videos_keep_their_own_times(tmp_path: Path) -> None:
    write_video(tmp_path / "rec" / "cam0.mp4", IRREGULAR_US)
    write_video(tmp_path / "rec" / "cam1.mp4", [t + 700 for t in IRREGULAR_US if t != 66_001])
    session = import_one([str(tmp_path / "rec")], tmp_path, "s", ImportOptions(times="video"))
    assert verify(session) == []
    assert times_of(session, "cam0") == [t * US for t in IRREGULAR_US]
    assert numbers_of(session) == [
        {"cam0": 0, "cam1": 0}, {"cam0": 1, "cam1": 1}, {"cam0": 2}, {"cam0": 3, "cam1": 2},
        {"cam0": 4, "cam1": 3}, {"cam0": 5, "cam1": 4},
    ]  # fmt: skip
    assert [(gone.camera, gone.instant) for gone in session.manifest.missing] == [("cam1", 2)]
    assert session.manifest.sync is not None
    assert session.manifest.sync.spread_ns == (700 * US, 700 * US, 0, 700 * US, 700 * US, 700 * US)


def test_a_second_video_stream_is_said_not_dropped_in_silence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As Insta360's files have one for each lens."""
    path = tmp_path / "VID_1.insv"
    with av.open(str(path), "w", format="mp4") as container:
        streams = [container.add_stream("libx264", rate=30) for _ in range(2)]
        for stream in streams:
            stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for number in range(4):
            for level, stream in zip((40, 200), streams, strict=True):
                image = np.full((48, 64, 3), level, np.uint8)
                frame = av.VideoFrame.from_ndarray(image, format="bgr24")
                frame.pts, frame.time_base = number, Fraction(1, 30)
                container.mux(stream.encode(frame))
        for stream in streams:
            container.mux(stream.encode(None))
    assert run(["sessions", "import", str(path), "--out", str(tmp_path / "s")]) == ExitCode.OK
    talk = capsys.readouterr().err
    assert "VID_1.insv has more than one video stream; the first is imported" in talk
    assert "ffmpeg -i VID_1.insv -map 0:v:1 -c copy VID_1-2.mp4" in talk
    write_avi(tmp_path / "slow.avi", 24, 30)
    cameras = [f"a={path}", f"b={tmp_path / 'slow.avi'}"]
    assert (
        run(["sessions", "import", *cameras, "--out", str(tmp_path / "t"), "--synchronized"]) == ExitCode.OK
    )
    talk = capsys.readouterr().err
    assert "VID_1.insv has more than one video stream" in talk
    assert "slow.avi has 24 frames a second and VID_1.insv 30" in talk


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
    session = import_one([str(tmp_path / "rec")], tmp_path, "s", ImportOptions(times="video"))
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
    session = import_one([str(folder)], tmp_path, "s", options)
    pairs = [images for images in session.images_by_instant() if len(images) == 2]
    assert [(of["left"].sequence, of["right"].sequence) for of in pairs] == [(0, 2), (1, 3), (2, 4), (3, 5)]
    assert pairs[0]["right"].leader_ns - pairs[0]["left"].leader_ns == 5 * MS


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
        ("20260131_142530_1", 1_769_869_530_000_000_000),
        ("2026-01-31 14.25.30.5", 1_769_869_530_500_000_000),
        ("1305031102.175304", 1_305_031_102_175_304_000),
        ("1305031102.5.color", 1_305_031_102_500_000_000),
        ("1403636579_763555527", 1_403_636_579_763_555_527),
        ("1403636579-763555", 1_403_636_579_763_555_000),
        ("cam0.1790000000123.25", 1_790_000_000_123_250_000),
        ("1403636579_0004", 1_403_636_579_000_000_000),
    ],
)
def test_times_in_names(name: str, time_ns: int) -> None:
    assert name_time_ns(Path(f"{name}.jpg")) == time_ns


@pytest.mark.parametrize("name", ["frame_000017", "20261331_142530", "holiday", "0000000005"])
def test_names_without_a_time(name: str) -> None:
    with pytest.raises(BadInputError, match=r"has no time|invalid time"):
        name_time_ns(Path(f"{name}.jpg"))


def test_images_are_matched_by_the_times_in_their_names(
    tmp_path: Path, make_images: Callable[..., Path]
) -> None:
    start_ms = 1_790_000_000_000
    folder = make_images("a", [f"{start_ms + 40 * n}.jpg" for n in range(4)]).parent
    make_images("b", [f"{start_ms + 40 * n + 7}.jpg" for n in (0, 1, 3)])
    session = import_one([str(folder)], tmp_path, "s", ImportOptions(times="name"))
    assert [len(images) for images in session.images_by_instant()] == [2, 2, 1, 2]
    assert session.images_by_instant()[3]["b"].sequence == 2
    assert session.manifest.sync is not None
    assert max(session.manifest.sync.spread_ns) == 7 * MS


def test_numbers_of_ten_digits_are_no_times(tmp_path: Path, make_images: Callable[..., Path]) -> None:
    """As KITTI's pictures are named."""
    folder = make_images("image_02", [f"{number:010}.png" for number in range(3)])
    for options in (ImportOptions(), ImportOptions(times="name")):
        with pytest.raises(BadInputError) as refused:
            import_one([f"a={folder}"], tmp_path / "out", "s", options)
        assert "--times name" not in str(refused.value)


def with_exif(data: bytes, date: str, part: str, order: str = "<", zone: str = "") -> bytes:
    """A JPEG with DateTimeOriginal and SubSecTimeOriginal, and OffsetTimeOriginal if there is a zone."""
    mark = b"II" if order == "<" else b"MM"
    text = date.encode() + b"\0"
    sub = part.encode().ljust(4, b"\0")[:4]
    first = struct.pack(f"{order}H", 1) + struct.pack(f"{order}HHII", 0x8769, 4, 1, 26) + bytes(4)
    end = 56 + 12 * bool(zone)
    inner = struct.pack(f"{order}H", 2 + bool(zone)) + struct.pack(f"{order}HHII", 0x9003, 2, len(text), end)
    if zone:
        inner += struct.pack(f"{order}HHII", 0x9011, 2, len(zone) + 1, end + len(text))
    inner += struct.pack(f"{order}HHI", 0x9291, 2, len(part) + 1) + sub + bytes(4)
    tiff = mark + struct.pack(f"{order}HI", 42, 8) + first + inner
    body = b"Exif\0\0" + tiff.ljust(end, b"\0") + text + zone.encode() + b"\0"
    return data[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + data[2:]


@pytest.mark.parametrize("zone", ["+01:00", ""])
def test_exif_is_in_utc_if_all_cameras_state_their_zone(tmp_path: Path, zone: str) -> None:
    for camera, own, hour, part in (("a", "+02:00", 14, "100"), ("b", zone, 13, "105")):
        folder = tmp_path / "rec" / camera
        folder.mkdir(parents=True)
        for number in range(2):
            data = with_exif(jpeg(number), f"2026:01:31 {hour}:25:3{number}", part, zone=own)
            (folder / f"DSC_{number}.jpg").write_bytes(data)
    options = ImportOptions(times="exif")
    if not zone:
        with pytest.raises(BadInputError, match=r"never meet: 3599"):
            import_one([str(tmp_path / "rec")], tmp_path, "s", options)
        return
    session = import_one([str(tmp_path / "rec")], tmp_path, "s", options)
    assert times_of(session, "b")[0] - times_of(session, "a")[0] == 5 * MS


@pytest.mark.parametrize(
    ("day", "hour", "zone", "doubtful"),
    [
        ("2025:10:26", 2, "", "2025-10-26: local time may have the hour from 02:00 twice"),
        ("2025:11:02", 1, "", "2025-11-02: local time may have the hour from 01:00 twice"),
        ("2026:04:05", 2, "", "2026-04-05: local time may have the hour from 02:00 twice"),
        ("2025:10:26", 2, "+01:00", ""),
        ("2025:10:26", 4, "", ""),
        ("2025:10:19", 2, "", ""),
        ("2025:10:27", 2, "", ""),
    ],
)
def test_the_hour_that_summer_time_has_twice_is_said(
    day: str, hour: int, zone: str, doubtful: str, tmp_path: Path
) -> None:
    for camera in "ab":
        (tmp_path / "rec" / camera).mkdir(parents=True)
        for number in range(2):
            data = with_exif(jpeg(number), f"{day} {hour:02}:25:3{number}", "100", zone=zone)
            (tmp_path / "rec" / camera / f"DSC_{number}.jpg").write_bytes(data)
    said: list[str] = []
    import_one([str(tmp_path / "rec")], tmp_path, "s", ImportOptions(times="exif"), talk=said.append)
    told = [line for line in said if line.startswith("summer time may end on ")]
    assert len(told) == bool(doubtful)
    assert doubtful in "".join(told)


def test_the_double_hour_in_file_names_is_said(tmp_path: Path) -> None:
    for camera in "ab":
        (tmp_path / "rec" / camera).mkdir(parents=True)
        for second in range(2):
            (tmp_path / "rec" / camera / f"IMG_20251026_02253{second}.jpg").write_bytes(jpeg(second))
    said: list[str] = []
    import_one([str(tmp_path / "rec")], tmp_path, "s", ImportOptions(times="name"), talk=said.append)
    assert any(line.startswith("summer time may end on 2025-10-26") for line in said)


@pytest.mark.parametrize("order", ["<", ">"])
def test_images_are_matched_by_their_exif(tmp_path: Path, order: str) -> None:
    for camera, parts in (("a", ("100", "500", "900")), ("b", ("105", "507", "899"))):
        folder = tmp_path / "rec" / camera
        folder.mkdir(parents=True)
        for number, part in enumerate(parts):
            data = with_exif(jpeg(number), "2026:01:31 14:25:30", part, order)
            (folder / f"DSC_{number}.jpg").write_bytes(data)
    session = import_one([str(tmp_path / "rec")], tmp_path, "s", ImportOptions(times="exif"))
    assert times_of(session, "b") == [1_769_869_530_000 * MS + t * MS for t in (105, 507, 899)]
    assert [len(images) for images in session.images_by_instant()] == [2, 2, 2]
    assert session.image_file(session.manifest.images[0]).read_bytes()[:4] == b"\xff\xd8\xff\xe1"


def test_broken_or_absent_exif_says_so(tmp_path: Path) -> None:
    folder = tmp_path / "rec" / "a"
    folder.mkdir(parents=True)
    options = ImportOptions(times="exif")
    (folder / "1.jpg").write_bytes(jpeg(0))
    with pytest.raises(BadInputError, match="no EXIF"):
        import_one([str(tmp_path / "rec")], tmp_path / "out", "s", options)
    good = with_exif(jpeg(0), "2026:01:31 14:25:30", "1")
    for broken in (good.replace(b"II*\0", b"XX*\0"), good.replace(b"II*\0\x08\0", b"II*\0\xff\xff")):
        (folder / "1.jpg").write_bytes(broken)
        with pytest.raises(BadInputError, match="broken"):
            import_one([str(tmp_path / "rec")], tmp_path / "out", "s", options)
    (folder / "1.jpg").write_bytes(with_exif(jpeg(0), "2026:01:31 14:25:30", "ab"))
    with pytest.raises(BadInputError, match=r"1\.jpg: SubSecTimeOriginal in its EXIF is 'ab', which is not"):
        import_one([str(tmp_path / "rec")], tmp_path / "out", "s", options)
    assert not list((tmp_path / "out").glob("*"))


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--time-shift-ms", "cam9=1"], "cam9, which the recording lacks"),
        (["--times", "name"], "not a folder of images"),
        (["--times", "video", "--fps", "30"], "either the rate"),
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
    assert len([line for line in error.splitlines() if not line.startswith("found ")]) == 1
    assert not list((tmp_path / "out").glob("*"))


@pytest.mark.parametrize("shift", ["cam0", "cam0=inf", "=1", "cam0=1e99"])
def test_a_shift_that_is_none_is_refused(shift: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["sessions", "import", "rec", "--time-shift-ms", shift]) == ExitCode.USAGE
    assert f"'{shift}' is not CAMERA=MS" in capsys.readouterr().err


def test_a_table_whose_times_go_backwards_is_refused(
    tmp_path: Path, make_images: Callable[..., Path]
) -> None:
    folder = make_images("a", ["0.jpg", "1.jpg", "2.jpg"])
    table = tmp_path / "times.csv"
    table.write_text("camera,frame,time_ms\na,0,0\na,1,80\na,2,40\n")
    with pytest.raises(BadInputError, match="times go backwards: frame 2 is 40 ms before frame 1"):
        import_one([f"a={folder}"], tmp_path / "out", "s", ImportOptions(timestamps=[("", table)]))


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


@pytest.mark.parametrize("at_ns", [10**300, -(10**300)], ids=["late", "early"])
def test_a_time_out_of_range_is_named(at_ns: int) -> None:
    frames = sorted([TimedFrame(0, 0), TimedFrame(1, at_ns)], key=lambda frame: frame.leader_ns)
    with pytest.raises(BadInputError, match="camera a: the time of frame 1 is out of range"):
        timeline_by_times("x", {"a": frames, "b": [TimedFrame(0, 0), TimedFrame(1, 1)]})


EPOCH_NS = 1_700_000_000_000 * MS


def write_avi(path: Path, fps: float, count: int) -> None:
    path.parent.mkdir(exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), fps, (32, 24))
    for number in range(count):
        writer.write(np.full((24, 32, 3), number % 250, np.uint8))
    writer.release()


def test_videos_of_different_rates_are_not_silently_taken_as_synchronized(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, fps in (("left", 25.0), ("right", 24.0)):
        write_avi(tmp_path / "rec" / f"{name}.avi", fps, 20)
    command = ["sessions", "import", str(tmp_path / "rec"), "--synchronized", "--out", str(tmp_path)]
    assert run([*command, "--name", "s"]) == 0
    done = capsys.readouterr()
    assert "right.avi has 24 frames a second and left.avi 25: with --synchronized they are" in done.err
    assert run(["sessions", "show", str(tmp_path / "s")]) == 0
    shown = capsys.readouterr().out
    assert "0 ns apart" not in shown
    assert "how far images of one instant are apart is not known" in shown
    assert "no times were recorded" in shown


def test_equal_times_of_a_table_are_recorded_times(
    tmp_path: Path, make_images: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    for camera in ("cam0", "cam1"):
        rows = [f"{EPOCH_NS + n * 50 * MS},{n}.png" for n in range(4)]
        folder = make_images(camera, [f"{n}.png" for n in range(4)]).parent
        (folder / camera / "data.csv").write_text("\n".join(["#timestamp [ns],filename", *rows]))
    assert run(["sessions", "import", str(folder), "--out", str(tmp_path / "out"), "--name", "s"]) == 0
    shown = capsys.readouterr().out
    assert "0 ns apart by the recorded times" in shown
    assert "no times were recorded" not in shown


def test_a_rate_that_contradicts_the_files_is_refused_or_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, fps in (("left", 25.0), ("right", 50.0)):
        write_avi(tmp_path / "rec" / f"{name}.avi", fps, 20)
    command = ["sessions", "import", str(tmp_path / "rec"), "--out", str(tmp_path / "out"), "--fps"]
    assert run([*command, "30"]) == ExitCode.BAD_INPUT
    refused = capsys.readouterr().err
    assert "state other rates than 30 frames a second: left.avi 25, right.avi 50 (leave out --fps" in refused
    assert run([*command, "30", "--synchronized", "--name", "triggered"]) == ExitCode.OK
    assert "right.avi states 50 frames a second: with 30, its 0.4 s become 0.7 s" in capsys.readouterr().err
    # As slow motion is, which states the rate at which it is shown.
    (tmp_path / "rec" / "right.avi").unlink()
    write_avi(tmp_path / "rec" / "right.avi", 25, 20)
    assert run([*command, "240", "--name", "slow"]) == ExitCode.OK
    said = capsys.readouterr()
    assert "left.avi states 25 frames a second: with 240, its 0.8 s become 0.1 s" in said.err
    assert "by panel, sound, flash, gopro not tried: that takes the videos' own times" in said.out
    assert run([*command, "25", "--name", "same"]) == ExitCode.OK
    assert "states" not in capsys.readouterr().err


def test_cameras_of_other_rates_lack_no_frame() -> None:
    """Of 25, 30 and 50 frames a second each has one within half the longest period."""
    cameras = {
        name: [TimedFrame(n, round(n * 1e9 / fps)) for n in range(4 * fps)]
        for name, fps in (("a", 25), ("b", 30), ("c", 50))
    }
    timeline = at_slowest_rate(timeline_by_times("x", cameras), lambda said: None)
    assert len(timeline.instants) == 100
    assert all(set(instant.frames) == {"a", "b", "c"} for instant in timeline.instants)
    assert not any(instant.why_missing for instant in timeline.instants)
    used = [instant.frames["b"].index for instant in timeline.instants]
    assert len(set(used)) == len(used)
    del cameras["b"][30:36]
    without = at_slowest_rate(timeline_by_times("x", cameras), lambda said: None)
    assert [round(i.leader_ns / 4e7) for i in without.instants if "b" not in i.frames] == [25, 26, 27, 28, 29]


def test_tables_that_never_meet_are_refused_with_their_distance(
    tmp_path: Path, make_images: Callable[..., Path]
) -> None:
    folder = make_images("a", ["0.jpg", "1.jpg", "2.jpg"]).parent
    make_images("b", ["0.jpg", "1.jpg", "2.jpg"])
    table = tmp_path / "ticks.csv"
    rows = [f"{name},{n},{start + n / 10}" for name, start in (("a", 20), ("b", 3806.5)) for n in range(3)]
    table.write_text("\n".join(["camera,frame,time", *rows]))
    options = ImportOptions(timestamps=[("", table)])
    with pytest.raises(
        BadInputError, match=r"never meet: 3786.3 s pass .* 3786.5 s between their beginn"
    ) as no:
        import_one([str(folder)], tmp_path, "s", options)
    assert "--time-shift-ms" in str(no.value)
    shifted = ImportOptions(timestamps=[("", table)], offsets_ms={"b": -3_786_500.0})
    assert not import_one([str(folder)], tmp_path, "s", shifted).manifest.missing


def test_images_named_by_times_are_told_how_to_be_taken(tmp_path: Path) -> None:
    for name in ("left", "right"):
        (tmp_path / "rec" / name).mkdir(parents=True)
        for number in range(3):
            (tmp_path / "rec" / name / f"{1_700_000_000_000_000 + 33_333 * number}.jpg").write_bytes(jpeg(1))
    with pytest.raises(BadInputError, match="named by times") as refused:
        import_one([str(tmp_path / "rec")], tmp_path, "s", ImportOptions())
    assert "--times name" in str(refused.value)
