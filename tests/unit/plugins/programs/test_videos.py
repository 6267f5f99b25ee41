"""Videos for MP4's own readers, FreeMoCap, Pose2Sim and Caliscope: times exact, nothing shifted."""

import csv
import tomllib
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from capture_app.common.errors import BadInputError
from capture_app.companions.importing.import_options import ImportOptions
from capture_app.plugins.programs.caliscope.caliscope_writer import camera_numbers
from capture_app.session.exporting.csv_tables import paired_names
from capture_app.session.exporting.videos import write_video
from capture_app.session.format.export_record import FRAMES
from capture_app.session.reading.reader import Session
from capture_app.session.writing.session_writer import SessionWriter
from tests.imported import import_one
from tests.unit.plugins.programs.conftest import (
    GRID,
    PERIOD_NS,
    RESIDUALS_NS,
    START_NS,
    Export,
    Make,
    calibrated,
    grey,
)
from tests.unit.session.recorded import record


def frames(path: Path) -> list[tuple[int, int]]:
    """Time in us and brightness of each frame, by FFmpeg."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        return [
            (round(frame.pts * stream.time_base * 10**6), int(frame.to_ndarray(format="bgr24")[4, 10, 0]))
            for frame in container.decode(stream)
        ]


def table(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


def since_us(session: Session, camera: str) -> dict[int, int]:
    """By instant, an image's time in us since the session's earliest image."""
    images = session.manifest.images
    first_ns = min(image.leader_ns for image in images)
    return {i.instant: (i.leader_ns - first_ns + 500) // 1000 for i in images if i.camera == camera}


def test_mp4_has_exact_times_and_no_frame_where_none_is(make: Make, export: Export, tmp_path: Path) -> None:
    session = make()
    export(session, "mp4")
    for camera in ("left", "mid", "right"):
        found = frames(tmp_path / "out" / f"{camera}.mp4")
        times = since_us(session, camera)
        assert [time for time, _ in found] == list(times.values())
        assert [level for _, level in found] == pytest.approx(
            [grey(camera, instant) for instant in times], abs=5
        )
    assert since_us(session, "right")[0] == 9  # 8,888 ns after the earliest: not lost in a millisecond


def packets(path: Path) -> tuple[str, list[tuple[int, bytes]]]:
    """Codec of a video, and time in us and bytes of each packet, by FFmpeg."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        found = [packet for packet in container.demux(stream) if packet.dts is not None]
        times = [round(packet.pts * stream.time_base * 10**6) for packet in found]
        return stream.codec_context.name, [*zip(times, map(bytes, found), strict=True)]


def test_mp4_of_a_recording_has_its_own_jpegs(tmp_path: Path, export: Export) -> None:
    with SessionWriter.create(tmp_path, "recording") as writer:
        session = record(writer)
    exported = export(session, "mp4")
    for camera, count in (("left", 3), ("right", 2)):
        images = [image for image in session.manifest.images if image.camera == camera]
        codec, found = packets(tmp_path / "out" / f"{camera}.mp4")
        assert (codec, len(found)) == ("mjpeg", count)
        assert found == [
            (since_us(session, camera)[image.instant], session.image_bytes(image)) for image in images
        ]
        assert len(frames(tmp_path / "out" / f"{camera}.mp4")) == count, "they are decoded"
    assert any("--codec h264" in note for note in exported.notes)


def test_mp4_of_a_recording_is_encoded_on_request(tmp_path: Path, export: Export) -> None:
    with SessionWriter.create(tmp_path, "recording") as writer:
        session = record(writer)
    export(session, "mp4", codec="h264")
    codec, found = packets(tmp_path / "out" / "left.mp4")
    assert (codec, [time for time, _ in found]) == ("h264", list(since_us(session, "left").values()))


def test_a_substitute_that_is_its_neighbours_frame_is_shown_once(
    make: Make, export: Export, tmp_path: Path
) -> None:
    to_next_ns = PERIOD_NS + RESIDUALS_NS["mid"]
    session = make(substitutes={("mid", 0): to_next_ns})
    export(session, "mp4")
    assert len(frames(tmp_path / "out" / "mid.mp4")) == 3
    rows = table(tmp_path / "out" / FRAMES)
    contents = {(row["camera"], row["instant"]): row["content"] for row in rows}
    assert contents["mid", "0"] == "left out"
    assert contents["mid", "1"] == "image"


def test_odd_sizes_keep_their_size(make: Make, export: Export, tmp_path: Path) -> None:
    export(make(sizes={"mid": (81, 63)}, calibrate=()), "mp4")
    capture = cv2.VideoCapture(str(tmp_path / "out" / "mid.mp4"))
    assert (capture.get(cv2.CAP_PROP_FRAME_WIDTH), capture.get(cv2.CAP_PROP_FRAME_HEIGHT)) == (81, 63)
    capture.release()


def test_the_table_has_every_camera_and_instant(make: Make, export: Export, tmp_path: Path) -> None:
    session = make()
    export(session, "freemocap")
    rows = table(tmp_path / "out" / FRAMES)
    assert len(rows) == 12
    exact = {(i.camera, str(i.instant)): i.leader_ns for i in session.manifest.images}
    for row in rows:
        place = (row["camera"], row["instant"])
        assert row["leader_ns"] == str(exact.get(place, ""))
        blank = place in {("right", "1"), ("mid", "2")}
        assert row["content"] == ("blank" if blank else "image")
        number = ("left", "mid", "right").index(row["camera"])
        assert row["file"] == f"synchronized_videos/clap.id-{row['camera']}.idx-{number}.mp4"
        assert row["frame"] == row["instant"]


@pytest.mark.parametrize(
    ("name", "videos", "calibration", "per_metre"),
    [
        ("freemocap", "synchronized_videos", "clap_camera_calibration.toml", 1000.0),
        ("pose2sim", "videos", "calibration/Calib.toml", 1.0),
    ],
)
def test_motion_capture(
    make: Make, export: Export, tmp_path: Path, name: str, videos: str, calibration: str, per_metre: float
) -> None:
    report = export(make(), name)
    out = tmp_path / "out"
    found = sorted((out / videos).iterdir())
    cameras = ("left", "mid", "right")
    # FreeMoCap 2 reads a camera's id and index from its video's name.
    named = {"pose2sim": "{}.mp4", "freemocap": "clap.id-{}.idx-{}.mp4"}[name]
    assert [path.name for path in found] == [
        named.format(*pair) for pair in zip(cameras, range(3), strict=True)
    ]
    for camera, path in zip(cameras, found, strict=True):
        shown = frames(path)
        assert [time for time, _ in shown] == [(slot * PERIOD_NS + 500) // 1000 for slot in GRID]
        levels = [
            0 if (camera, i) in {("right", 1), ("mid", 2)} else grey(camera, i) for i in range(len(GRID))
        ]
        assert [level for _, level in shown] == pytest.approx(levels, abs=5)
        capture = cv2.VideoCapture(str(path))  # how these programs count
        assert capture.get(cv2.CAP_PROP_FRAME_COUNT) == len(GRID)
        capture.release()
    tables = tomllib.loads((out / calibration).read_text())
    assert sorted(set(tables) - {"metadata"}) == ["left", "mid", "right"]
    for camera in ("left", "mid", "right"):
        table, truth = tables[camera], calibrated(camera)
        assert table["name"] == camera
        assert table["size"] == [truth.width, truth.height]
        if name == "pose2sim" or not truth.distortion[4]:
            assert table["matrix"] == [[truth.fx, 0, truth.cx], [0, truth.fy, truth.cy], [0, 0, 1]]
            assert table["distortions"] == list(truth.distortion)
        else:
            assert table["distortions"][4] == 0.0  # FreeMoCap knows no k3
        assert table["translation"] == pytest.approx([v * per_metre for v in truth.translation])
        rotation = cv2.Rodrigues(np.array(table["rotation"]))[0]
        assert rotation == pytest.approx(np.array(truth.rotation), abs=1e-12)
    assert any("2 frames are black" in note for note in report.notes)
    assert any("unevenly spaced" in note for note in report.notes)


def test_freemocap_may_calibrate_itself(make: Make, export: Export, tmp_path: Path) -> None:
    export(make(calibrate=()), "freemocap")
    assert not list((tmp_path / "out").glob("*.toml"))


def test_a_unit_that_is_no_length_is_said(make: Make, export: Export) -> None:
    report = export(make(unit="squares"), "pose2sim")
    assert any("'squares'" in note for note in report.notes)


def test_videos_and_tables_pair_however_they_are_sorted() -> None:
    assert paired_names(["b", "a"]) == {"a": "a", "b": "b"}
    names = paired_names(["cam10", "cam9"])
    assert list(names.values()) == sorted(names.values()) == ["cam_000_cam9", "cam_001_cam10"]
    assert "metadata" not in paired_names(["metadata", "x"]).values()


def test_caliscope_keeps_the_numbers_of_cameras() -> None:
    assert camera_numbers(("cam_3", "cam_10")) == {"cam_3": 3, "cam_10": 10}
    assert camera_numbers(("cam03", "cam10")) == {"cam03": 3, "cam10": 10}
    assert camera_numbers(("cam_3", "left")) == {"cam_3": 0, "left": 1}
    assert camera_numbers(("cam_3", "cam3")) == {"cam_3": 0, "cam3": 1}


def test_caliscope_comes_back_through_our_import(make: Make, export: Export, tmp_path: Path) -> None:
    session = make()
    report = export(session, "caliscope")
    assert "cam_1 is mid" in report.notes
    recording = tmp_path / "out" / "recordings" / "clap"
    assert sorted(path.name for path in recording.iterdir()) == [
        *(f"cam_{number}.mp4" for number in range(3)),
        "timestamps.csv",
    ]
    rows = table(recording / "timestamps.csv")
    assert list(rows[0]) == ["sync_index", "cam_id", "frame_time"]
    first_ns = START_NS - 8_765
    times = {(i.camera, i.leader_ns - first_ns) for i in session.manifest.images}
    cameras = ("left", "mid", "right")
    found = {(cameras[int(r["cam_id"])], int(r["frame_time"].replace(".", ""))) for r in rows}
    assert found == times
    for number, camera in enumerate(cameras):
        assert len(frames(recording / f"cam_{number}.mp4")) == sum(name == camera for name, _ in times)
    array = str(tmp_path / "out" / "camera_array.toml")
    options = ImportOptions(timestamps=[("", recording / "timestamps.csv")], calibration=(array,))
    back = import_one([str(recording)], tmp_path / "back", "back", options)
    again = back.calibration()
    assert again is not None
    for number, camera in enumerate(cameras):
        one, truth = again.cameras[f"cam_{number}"], calibrated(camera)
        assert (one.fx, one.cx, one.distortion) == (truth.fx, truth.cx, truth.distortion)
        assert np.array(one.rotation) == pytest.approx(np.array(truth.rotation), abs=1e-12)
        assert one.translation == pytest.approx(truth.translation)
    assert len(back.manifest.images) == len(session.manifest.images)


def test_two_frames_of_one_microsecond_are_refused(tmp_path: Path) -> None:
    """A player would show one of them."""
    pictures = [(0, np.zeros((12, 16, 3), np.uint8)), (400, np.zeros((12, 16, 3), np.uint8))]
    with pytest.raises(BadInputError, match="within the same microsecond, 0"):
        write_video(tmp_path / "left.mp4", pictures, (16, 12), PERIOD_NS)
