"""A take as a picture to show around, by the commands."""

import json
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from capture_app.cli import run
from capture_app.common.errors import BadInputError, ExitCode
from capture_app.session.reading import take_sheet
from capture_app.session.reading.reader import Session
from capture_app.session.reading.take_sheet import (
    GAP,
    GUTTER,
    HEAD,
    TakeSheet,
    contact_sheet,
    sheet_instants,
    wiggle_frames,
)
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


@pytest.mark.parametrize(("limit", "most"), [("MAX_SIDE", 240), ("MAX_PIXELS", 240 * (GUTTER + 2 * 70))])
def test_a_long_take_is_shown_in_steps(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    limit: str,
    most: int,
) -> None:
    take = make_take(tmp_path, cameras=2, instants=10)
    monkeypatch.setattr(take_sheet, limit, most)
    out = tmp_path / "sheet.jpg"
    assert run(["sessions", "sheet", str(take.folder), "--out", str(out), "--width", "64", "--json"]) == 0
    printed = capsys.readouterr()
    assert "one in 4 instants is shown: all 10" in printed.err
    assert json.loads(printed.out)["every"] == 4
    picture = cv2.imread(str(out))
    # Instants 0, 4 and 8 of the first camera; a fifth row would be too many.
    assert picture.shape[0] == HEAD + 3 * (48 + GAP)
    for row, instant in enumerate((0, 4, 8)):
        shown = picture[HEAD + row * (48 + GAP) + 24, GUTTER + 32].astype(int)
        assert np.abs(shown - colour_of(instant)).max() <= 3


def test_a_tall_sheet_continues_beside_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sheet = TakeSheet(make_take(tmp_path, cameras=2, instants=5))
    monkeypatch.setattr(take_sheet, "MAX_HEIGHT", HEAD + 2 * (48 + GAP))
    picture = contact_sheet(sheet, 64)
    wide = GUTTER + 2 * (64 + GAP)
    assert picture.shape[:2] == (HEAD + 2 * (48 + GAP), 3 * wide)
    for instant in range(5):
        top, left = HEAD + instant % 2 * (48 + GAP), instant // 2 * wide + GUTTER
        assert np.abs(picture[top + 24, left + 32].astype(int) - colour_of(instant)).max() <= 3
        assert len(np.unique(picture[top : top + 20, left - GUTTER : left - 6].reshape(-1, 3), axis=0)) > 1


@pytest.mark.parametrize("instants", [1, 464, 108_000])
def test_a_sheet_of_a_film_of_an_hour_fits_a_picture(instants: int) -> None:
    sheet = SimpleNamespace(aspect=9 / 16, cameras=("left", "right"), instants=instants)
    rows = len(sheet_instants(sheet, 240))  # type: ignore[arg-type]
    assert min(instants, 464) / 2 < rows <= (65_500 - HEAD) // (135 + GAP)


@pytest.mark.parametrize(("cameras", "width"), [(20, 4000), (1000, 64)])
def test_a_sheet_beyond_reason_is_refused(cameras: int, width: int) -> None:
    sheet = SimpleNamespace(aspect=3.0, cameras=range(cameras), instants=1)
    with pytest.raises(BadInputError, match="choose a smaller --width"):
        contact_sheet(sheet, width)  # type: ignore[arg-type]


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
