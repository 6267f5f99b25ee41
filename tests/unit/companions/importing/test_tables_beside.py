"""Tables of times beside a recording are found, tried, and taken if one clock gave them."""

import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest

from capture_app.cli import run
from capture_app.common.errors import BadInputError, ExitCode
from capture_app.session.format.common_times import CommonTimes
from capture_app.session.reading.reader import Session
from tests.unit.companions.importing.numbered_video import imported, numbers_of, write_video

EPOCH_S = 1_700_000_000
LATE = [{"a": 0}, {"a": 1, "b": 0}, {"a": 2, "b": 1}, {"a": 3, "b": 2}, {"b": 3}]
"""What is of one instant where b began a frame later than a, by number."""


def clips(folder: Path, names: Sequence[str] = ("a", "b"), count: int = 4) -> None:
    for name in names:
        write_video(folder / f"{name}.mp4", [100_000 * n for n in range(count)])


def rows(begin_s: float, count: int = 4) -> str:
    return "\n".join(["time", *(f"{begin_s + n / 10:.3f}" for n in range(count))])


def common(session: Session) -> CommonTimes:
    times = session.manifest.burst.common_times
    assert times is not None
    return times


@pytest.mark.parametrize("inner", ["", "calibration/extrinsic"])
def test_a_table_beside_the_videos_is_taken_at_any_depth(tmp_path: Path, inner: str) -> None:
    folder = tmp_path / "workspace" / inner
    clips(folder, ("cam_0", "cam_1"))
    lines = [f"{n},{cam},{n / 10 + cam / 1000}" for n in range(4) for cam in (0, 1)]
    (folder / "timestamps.csv").write_text("\n".join(["sync_index,cam_id,frame_time", *lines]))
    (folder / "xy.csv").write_text("sync_index,cam_id,point_id,img_loc_x\n0,0,1,2\n")
    session, said = imported(tmp_path / "workspace")
    assert common(session) == CommonTimes(state="recorded", reason="the table timestamps.csv")
    if inner:
        assert "times: timestamps.csv, 4 of 4 frames" in said
    assert numbers_of(session) == [{"cam_0": n, "cam_1": n} for n in range(4)]


def test_a_table_that_does_not_fit_is_named_with_the_reason(tmp_path: Path) -> None:
    clips(tmp_path / "rec")
    (tmp_path / "rec" / "times.csv").write_text("camera,frame,time\na,0,0.1\na,1,0.2\n")
    session, said = imported(tmp_path / "rec")
    assert "times: times.csv: not taken: " in said
    assert "has no times of camera b; it names a" in said
    assert common(session).unknown


@pytest.mark.parametrize(
    "files", [("a.csv", "b.csv"), ("a_timestamps.csv", "b_timestamps.csv"), ("A.csv", "B.csv")]
)
def test_dates_of_each_camera_are_taken(tmp_path: Path, files: Sequence[str]) -> None:
    clips(tmp_path / "rec")
    for name, late_s in zip(files, (0, 0.101), strict=True):
        (tmp_path / "rec" / name).write_text(rows(EPOCH_S + late_s))
    session, said = imported(tmp_path / "rec")
    assert f"times: {', '.join(files)}, 4 of 4 frames" in said
    assert common(session) == CommonTimes(state="recorded", reason=f"the tables {', '.join(files)}")
    assert numbers_of(session) == LATE


@pytest.mark.parametrize("form", ["{}.csv", "{}_ts.csv", "{}-frame times.csv", "{}.metadata.csv"])
def test_names_that_end_like_those_of_tables_are_cameras(tmp_path: Path, form: str) -> None:
    clips(tmp_path / "rec", ("links", "rechts"))
    for name, late_s in (("links", 0), ("rechts", 0.101)):
        (tmp_path / "rec" / form.format(name)).write_text(rows(EPOCH_S + late_s))
    session, _ = imported(tmp_path / "rec")
    assert common(session).state == "recorded"


@pytest.mark.parametrize("file", ["frames.csv", "video.csv"])
def test_a_table_in_each_cameras_folder_is_taken(tmp_path: Path, file: str) -> None:
    for name, late_s in (("a", 0), ("b", 0.101)):
        clips(tmp_path / "rec" / name, ("video",))
        (tmp_path / "rec" / name / file).write_text(rows(EPOCH_S + late_s))
    session, _ = imported(tmp_path / "rec")
    assert (common(session).state, numbers_of(session)) == ("recorded", LATE)


def test_dates_as_bonsai_writes_them(tmp_path: Path) -> None:
    """Without a header, with seven digits of a second."""
    clips(tmp_path / "rec")
    for name, late in (("a", 0), ("b", 1)):
        dates = [f"2023-05-01T12:00:00.{n + late}001234+00:00" for n in range(4)]
        (tmp_path / "rec" / f"{name}.csv").write_text("\n".join(dates))
    session, _ = imported(tmp_path / "rec")
    assert (common(session).state, numbers_of(session)) == ("recorded", LATE)


@pytest.mark.parametrize("begins_s", [(0.0, 0.0), (12.5, 12.6)])
def test_times_since_some_start_are_a_question(tmp_path: Path, begins_s: tuple[float, float]) -> None:
    clips(tmp_path / "rec")
    for name, begin_s in zip("ab", begins_s, strict=True):
        (tmp_path / "rec" / f"{name}.csv").write_text(rows(begin_s))
    session, said = imported(tmp_path / "rec")
    assert common(session).unknown
    given = [f"{name}={tmp_path / 'rec' / f'{name}.csv'}" for name in "ab"]
    assert f"if one clock gave them: --timestamps {given[0]} --timestamps {given[1]}" in said
    command = ["sessions", "import", str(tmp_path / "rec"), "--out", str(tmp_path), "--name", "given"]
    assert run([*command, "--timestamps", given[0], "--timestamps", given[1]]) == ExitCode.OK
    session = Session.open(tmp_path / "given")
    assert common(session) == CommonTimes(state="recorded", reason="the tables a.csv, b.csv")


def test_two_tables_belong_to_the_cameras_that_they_are_named_after(tmp_path: Path) -> None:
    clips(tmp_path / "rec")
    tables = [tmp_path / f"{name}.csv" for name in "ab"]
    for late_s, table in zip((0, 0.101), tables, strict=True):
        table.write_text(rows(12 + late_s))
    session, _ = imported(tmp_path / "rec", timestamps=[("", table) for table in reversed(tables)])
    assert numbers_of(session) == LATE


def test_images_have_the_times_that_a_table_gives_their_names(tmp_path: Path, make_images: object) -> None:
    """As robots' data sets have it: cam0/data/*.png, cam0/data.csv."""
    for camera, late in (("cam0", 0), ("cam1", 1)):
        names = [f"{1_700_000_000_000_000_000 + 100_000_000 * (n + late)}" for n in range(4)]
        make_images(camera, [f"{name}.png" for name in names])  # type: ignore[operator]
        lines = [f"{name},{name}.png" for name in names]
        table = tmp_path / "recording" / camera / "data.csv"
        table.write_text("\n".join(["#timestamp [ns],filename", *lines]))
    session, said = imported(tmp_path / "recording")
    assert "times: data.csv, data.csv, 4 of 4 frames" in said
    assert (common(session).state, len(session.manifest.burst.instants_ns)) == ("recorded", 5)


@pytest.mark.parametrize("lost", [None, 2])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_rows_of_kitti_belong_to_the_numbers_of_pictures(
    tmp_path: Path, make_images: object, lost: int | None, encoding: str
) -> None:
    """https://www.cvlibs.net/datasets/kitti/raw_data.php: data/0000000000.png, a row more than these."""
    for camera, late_ms in (("image_00", 0), ("image_01", 7)):
        names = [f"{n:010}.png" for n in range(5) if n != lost or camera == "image_00"]
        make_images(f"{camera}/data", names)  # type: ignore[operator]
        rows = [f"2011-09-26 13:02:25.{100 * n + late_ms:03}000000" for n in range(6)]
        table = tmp_path / "recording" / camera / "timestamps.txt"
        table.write_text("\n".join(rows), encoding=encoding)
    session, _ = imported(tmp_path / "recording")
    assert common(session).state == "recorded"
    times_ns = [image.leader_ns % 10**9 for image in session.manifest.images if image.camera == "image_01"]
    assert times_ns == [(100 * n + 7) * 10**6 for n in range(5) if n != lost]
    assert [len(images) for images in session.images_by_instant()] == [2 - (n == lost) for n in range(5)]


def test_rows_of_pictures_that_count_from_another_number_are_not_guessed(
    tmp_path: Path, make_images: object
) -> None:
    for camera in ("a", "b"):
        make_images(camera, [f"{n:06}.png" for n in range(1, 5)])  # type: ignore[operator]
        rows = [f"2026-01-31 13:02:25.{n}00" for n in range(6)]
        (tmp_path / "recording" / camera / "times.txt").write_text("\n".join(rows))
    session, _ = imported(tmp_path / "recording", fps=30.0)
    assert common(session).state == "given"
    shutil.rmtree(tmp_path / "out")
    with pytest.raises(BadInputError, match="have no times"):
        imported(tmp_path / "recording")


@pytest.mark.parametrize("count", [4, 3])
def test_one_table_of_kittis_odometry_is_of_all_cameras(
    tmp_path: Path, make_images: object, count: int
) -> None:
    for camera in ("image_0", "image_1"):
        make_images(camera, [f"{n:06}.png" for n in range(4)])  # type: ignore[operator]
    times = [f"{0.1036 * n:.6e}" for n in range(count)]
    (tmp_path / "recording" / "times.txt").write_text("\n".join(times))
    if count < 4:
        with pytest.raises(BadInputError, match="have no times"):
            imported(tmp_path / "recording")
        return
    session, said = imported(tmp_path / "recording")
    assert common(session).state == "recorded"
    assert "times: times.txt, 4 of 4 frames" in said
    assert session.manifest.burst.instants_ns[-1] == round(3 * 103.6e6)


def test_a_cameras_own_table_is_not_of_all_cameras(tmp_path: Path, make_images: object) -> None:
    for camera in ("image_0", "image_1"):
        make_images(camera, [f"{n:06}.png" for n in range(4)])  # type: ignore[operator]
    (tmp_path / "recording" / "image_0" / "times.txt").write_text("\n".join(f"0.{n}" for n in range(4)))
    with pytest.raises(BadInputError, match="have no times"):
        imported(tmp_path / "recording")
