"""A take as a picture to show around, by the commands."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.cli import run
from capture_app.common.errors import BadInputError, ExitCode
from capture_app.session.reading.reader import Session
from capture_app.session.reading.take_sheet import GAP, GUTTER, HEAD, TakeSheet, wiggle_frames
from tests.unit.tui.takes import HEIGHT, WIDTH, make_take, picture_of


@pytest.fixture
def take(tmp_path: Path) -> Session:
    return make_take(tmp_path, cameras=4, instants=3)


def colour_of(number: int) -> np.ndarray:
    picture = cv2.imdecode(np.frombuffer(picture_of(number), np.uint8), cv2.IMREAD_COLOR)
    return picture[HEIGHT // 2, WIDTH // 2].astype(int)


def test_the_sheet_has_each_picture_in_its_place(
    take: Session, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "sheet.png"
    assert run(["sessions", "sheet", str(take.folder), "--out", str(out), "--width", "64", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["cameras"] == ["cam00", "cam01", "cam02", "cam03"]
    assert told["instants"] == 3
    assert told["verdict"]["grade"] == "excellent"
    picture = cv2.imread(str(out))
    assert picture.shape == (told["height"], told["width"], 3)
    for camera in range(4):
        for instant in range(3):
            x, y = GUTTER + camera * (64 + GAP) + 32, HEAD + instant * (48 + GAP) + 24
            assert np.abs(picture[y, x].astype(int) - colour_of(camera * 3 + instant)).max() <= 3


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_the_wiggle_goes_there_and_back(
    take: Session, tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str
) -> None:
    out = tmp_path / f"wiggle{suffix}"
    command = ["sessions", "wiggle", str(take.folder), "--out", str(out), "--width", "64", "--instant", "1"]
    assert run([*command, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["images"] == 4
    read, animation = cv2.imreadanimation(str(out))
    assert read
    assert len(animation.frames) == 6
    for frame, camera in zip(animation.frames, (0, 1, 2, 3, 2, 1), strict=True):
        # A GIF has 256 colours.
        assert np.abs(frame[24, 32, :3].astype(int) - colour_of(camera * 3 + 1)).max() <= 24
    assert run(command) == ExitCode.BAD_INPUT
    assert "exists already" in capsys.readouterr().err
    assert run([*command, "--replace"]) == 0


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["sheet", "--out", "sheet.bmp"], "use .jpg or .jpeg or .png"),
        (["wiggle", "--out", "w.gif", "--instant", "9"], "it has cam00, cam01, cam02, cam03 at 0 to 2"),
        (["wiggle", "--out", "w.mp4"], "use .gif or .webp"),
    ],
)
def test_mistakes_are_sentences(
    take: Session, capsys: pytest.CaptureFixture[str], arguments: list[str], reason: str
) -> None:
    assert run(["sessions", arguments[0], str(take.folder), *arguments[1:]]) != 0
    assert reason in capsys.readouterr().err


def test_a_sheet_beyond_reason_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    take = make_take(tmp_path, cameras=20, instants=12)
    out = str(tmp_path / "x.jpg")
    assert run(["sessions", "sheet", str(take.folder), "--out", out, "--width", "1000"]) != 0
    assert "choose a smaller --width" in capsys.readouterr().err


def test_a_wiggle_needs_two_pictures(tmp_path: Path) -> None:
    sheet = TakeSheet(make_take(tmp_path, cameras=1))
    with pytest.raises(BadInputError, match="a wiggle needs two"):
        wiggle_frames(sheet, 0, 64)


def test_pictures_that_are_damaged_make_no_wiggle(
    take: Session, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for image in take.images_by_instant()[1].values():
        take.image_file(image).write_bytes(b"no picture")
    out = tmp_path / "wiggle.gif"
    command = ["sessions", "wiggle", str(take.folder), "--out", str(out), "--instant", "1"]
    assert run(command) == ExitCode.BAD_INPUT
    assert "has 0 pictures of instant 1 that can be read" in capsys.readouterr().err
    assert not out.exists()
