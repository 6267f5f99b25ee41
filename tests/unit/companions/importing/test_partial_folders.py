"""Folders of which a part can be used: a mute clip, a later clip, chapters; and what is no recording."""

import shlex
import zipfile
from dataclasses import replace
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.cli import run
from capture_app.common.errors import BadInputError, ExitCode
from capture_app.companions.importing.clips import find_shoots
from capture_app.session.importing.importer import open_sources
from capture_app.session.importing.recording_sources import Video
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from tests.unit.companions.importing.numbered_video import numbers_of, write_video
from tests.unit.companions.importing.strangers import CLAPS, A, B
from tests.unit.session.conftest import jpeg


def imported(folder: Path, *arguments: str) -> Session:
    out = folder.parent / "out"
    call = ["sessions", "import", str(folder), "--out", str(out), "--name", "s", *arguments]
    assert run(call) == ExitCode.OK
    session = Session.open(out / "s")
    assert verify(session) == []
    return session


def test_a_count_is_from_where_all_run(tmp_path: Path) -> None:
    for name, phone in (("a", A), ("b", B)):
        replace(phone, fps=15).record(CLAPS, tmp_path / "in" / f"{name}.mp4", 6)
    session = imported(tmp_path / "in", "--count", "5")
    assert [len(images) for images in session.images_by_instant()] == [2] * 5


def test_chapters_of_a_gopro_are_one_recording(tmp_path: Path) -> None:
    for name, first in (("GX010012.MP4", 0), ("GX020012.MP4", 3), ("GX030012.MP4", 6)):
        write_video(tmp_path / "in" / name, (0, 33_000, 66_000), first=first)
    write_video(tmp_path / "in" / "GOPR0044.MP4", (0, 33_000, 66_000, 99_000, 132_000))
    write_video(tmp_path / "in" / "GP010044.MP4", (0, 33_000, 66_000, 99_000), first=5)
    shoots, left_out = find_shoots(tmp_path / "in")
    assert [sorted(clip.path.name for clip in clips.values()) for _, clips in shoots] == [
        ["GOPR0044.MP4", "GX010012.MP4"]
    ]
    assert left_out == []
    video = Video("a", tmp_path / "in" / "GX010012.MP4")
    assert video.notes == ("GX010012.MP4 goes on in GX020012.MP4, GX030012.MP4",)
    assert [at_ns // 1_000_000 for at_ns in video.own_times_ns()] == list(range(0, 297, 33))
    session = imported(tmp_path / "in")
    shown = numbers_of(session)
    assert len(shown) == 9
    assert all(set(of.values()) == {number} for number, of in enumerate(shown))


def refused(path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    assert run(["sessions", "import", str(path), "--out", str(path.parent / "out")]) == ExitCode.BAD_INPUT
    return capsys.readouterr().err


def test_what_is_no_recording_is_named_with_what_would_read_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with zipfile.ZipFile(tmp_path / "shoot.zip", "w") as archive:
        archive.writestr("a.mp4", b"")
    talk = refused(tmp_path / "shoot.zip", capsys)
    assert "is an archive" in talk
    assert f"capture-app sessions import {tmp_path / 'shoot'}" in talk
    (tmp_path / "packed").mkdir()
    (tmp_path / "shoot.zip").rename(tmp_path / "packed" / "shoot.zip")
    assert f"{Path('packed', 'shoot.zip')} is an archive" in refused(tmp_path / "packed", capsys)
    single = tmp_path / "single"
    single.mkdir()
    for number in range(3):
        (single / f"IMG_{number:04}.jpg").write_bytes(jpeg(number))
    talk = refused(single, capsys)
    assert "3 images, whose names tell no cameras apart" in talk
    assert f"capture-app sessions import cam0={single} --fps" in talk
    # As the line is quoted, no shell takes the pattern apart.
    line = f"capture-app sessions import '{single / 'IMG_000*.jpg'}'"
    assert line in talk
    out = ("--out", str(tmp_path / "out"))
    assert run([*shlex.split(line)[1:], *out]) == ExitCode.OK
    assert "3 cameras, 3 images, 0 missing" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["{}_{:04}", "image{}{}", "frame_{1:04}_{0}", "walk-{1}{0}"])
@pytest.mark.parametrize("place", ["", "images"])
def test_images_of_several_cameras_in_one_folder(
    tmp_path: Path, name: str, place: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """As in sourishg/stereo-calibration and niconielsen32/ComputerVision; suffixes too."""
    (tmp_path / "in" / place).mkdir(parents=True)
    for number, side in product(range(8, 11), ("L", "R")):
        (tmp_path / "in" / place / f"{name.format(side, number)}.jpg").write_bytes(jpeg(number))
    session = imported(tmp_path / "in", "--fps", "30")
    assert [camera.name[-1] for camera in session.manifest.cameras] == ["L", "R"]
    assert [len(images) for images in session.images_by_instant()] == [2, 2, 2]
    assert "R; 3 instants" in capsys.readouterr().err


def test_folders_with_images_of_several_cameras_are_takes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """calib_imgs/1 and calib_imgs/2, each with left and right (sourishg/stereo-calibration)."""
    for take, number, side in product("12", range(3), ("left", "right")):
        (tmp_path / "in" / take).mkdir(parents=True, exist_ok=True)
        (tmp_path / "in" / take / f"{side}{number}.jpg").write_bytes(jpeg(number))
    assert (
        run(["sessions", "import", str(tmp_path / "in"), "--fps", "30", "--out", str(tmp_path / "out")]) == 0
    )
    for take in "12":
        session = Session.open(tmp_path / "out" / f"in-{take}")
        assert [camera.name for camera in session.manifest.cameras] == ["left", "right"]
        assert [len(images) for images in session.images_by_instant()] == [2, 2, 2]
    assert "camera = left, right; take = 1, 2; 3 instants" in capsys.readouterr().err


def test_a_file_whose_name_is_no_camera_name_gets_one_like_it(tmp_path: Path) -> None:
    write_video(tmp_path / "in" / "My clip (1).mp4", (0, 33_000, 66_000))
    session = imported(tmp_path / "in" / "My clip (1).mp4")
    assert [camera.name for camera in session.manifest.cameras] == ["My-clip-1"]


def test_names_that_clash_are_refused_before_anything_is_read(tmp_path: Path) -> None:
    for camera in ("a", "b"):
        (tmp_path / camera).mkdir()
        (tmp_path / camera / "clip.mp4").write_bytes(b"no video, which is not looked at")
    with pytest.raises(BadInputError, match="two cameras are named clip"):
        open_sources([str(tmp_path / camera / "clip.mp4") for camera in ("a", "b")])


def test_a_link_out_of_the_folder_is_followed_and_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    private = tmp_path / "private" / "photo.jpg"
    for path in (private, tmp_path / "in" / "a" / "1.jpg", tmp_path / "in" / "b" / "1.jpg"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(jpeg(1))
    for name in ("a", "b"):
        (tmp_path / "in" / name / "2.jpg").symlink_to(private if name == "a" else "1.jpg")
    imported(tmp_path / "in", "--fps", "30")
    said = capsys.readouterr().err
    assert (
        f"1 link out of the folder followed, such as {tmp_path / 'in' / 'a' / '2.jpg'} to {private}" in said
    )
    assert said.count("followed") == 1


@pytest.mark.parametrize(
    ("name", "advice"),
    [
        ("IMG_0001.HEIC", "heif-convert"),
        ("a.gif", "ffmpeg -i"),
        ("bag_0.mcap", "capture-app sessions import"),
        ("bag_0.db3", "ros2 bag reindex"),
        ("notes.txt", "it needs a subfolder of images"),
    ],
)
def test_what_is_not_read_is_named_with_what_to_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, advice: str
) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / name).write_bytes(b"x")
    said = refused(tmp_path / "in", capsys)
    assert "no cameras in" in said
    assert advice in said
    assert (name in said) == (name != "notes.txt")


def test_what_a_tiff_has_besides_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pages = [np.full((12, 16), 4000, np.uint16), np.zeros((12, 16), np.uint16)]
    for camera, kept in (("a", pages), ("b", [page.astype(np.uint8) for page in pages[:1]])):
        (tmp_path / "in" / camera).mkdir(parents=True)
        cv2.imwritemulti(str(tmp_path / "in" / camera / "0.tiff"), kept)
    imported(tmp_path / "in", "--fps", "30")
    said = capsys.readouterr().err
    assert "a: 0.tiff has 2 pages, of which the first is imported" in said
    assert "a: 0.tiff has 16 bits, of which 12 are used" in said
    assert "b: 0.tiff" not in said
