"""Which pieces of files' names tell cameras, takes and instants apart, and where the names do not tell."""

from collections.abc import Sequence
from itertools import product
from pathlib import Path

import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.session.importing.name_roles import choose, parse_names, take_names
from capture_app.session.reading.reader import Session
from tests.unit.session.conftest import jpeg

LR, FIVE = ("left", "right"), range(5)
IMAGES: dict[str, tuple[Sequence[str], str]] = {
    "a picture a word": (["left", "right"], "left, right; one instant"),
    "a picture a numbered camera": ([f"cam{n:02}" for n in (1, 2, 3)], "cam01, cam02, cam03; one instant"),
    "a counter that stands still": (["A_001", "B_001"], "A, B; one instant"),
    "a ring's counters that stand still": (
        [f"{n:03}_0001_00001" for n in (1, 2, 3)],
        "001, 002, 003; one instant",
    ),
    "any script": (
        ["カメラ左_1", "カメラ左_2", "カメラ右_1", "カメラ右_2"],
        "カメラ左, カメラ右; 2 instants",
    ),
    "the camera after the number": ([f"{n}_{c}" for n, c in product(FIVE, LR)], "left, right; 5 instants"),
    "a padded counter beside a number": (
        [f"cal_{n:04}_{c}" for n, c in product(FIVE, (0, 1))],
        "0, 1; 5 instants",
    ),
    "a frame that one lacks": (["L1", "L2", "L3", "R1", "R3"], "L, R; 3 instants"),
    "cameras that share no time": (
        ["C_130757", "C_130758", "L_130801", "L_130802"],
        "C, L; 2 instants",
    ),
    "a take beside": (
        [f"take{t}_{c}_{n}" for t, c, n in product((1, 2), LR, FIVE)],
        "left, right; take = take1, take2; 5 instants",
    ),
    "folders of cameras": ([f"{c}/{n}" for c, n in product("12", FIVE)], "1, 2; 5 instants"),
    "folders of cameras, names of no form": (["a/x", "a/y1", "b/7", "b/z_8"], "a, b; 2 instants"),
    "folders of instants": (
        [f"{n:06}/cam{c}" for n, c in product(FIVE, (0, 1))],
        "cam0, cam1; 5 instants",
    ),
    "folders of takes and cameras": (
        [f"drive_{d:04}/image_{c:02}/data/{n:010}" for d, c, n in product((1, 5), (0, 1), FIVE)],
        "image_00, image_01; take = drive_0001, drive_0005; 5 instants",
    ),
    "folders of takes": (
        [f"{t}/{c}{n}" for t, c, n in product("12", LR, FIVE)],
        "left, right; take = 1, 2; 5 instants",
    ),
}
QUESTIONS: dict[str, Sequence[str]] = {
    "a counter": [f"IMG_{n:04}" for n in FIVE],
    "a counter of a camera": [f"cam{n:04}" for n in FIVE],
    "two numbers": [f"cal_{n}_{c}" for n, c in product(FIVE, (0, 1))],
    "seconds and a counter": [f"20260131_{n // 2 + 142530}_{n % 2}" for n in range(6)],
    "folders of numbers": [f"{n:06}/{c}" for n, c in product(FIVE, (0, 1))],
    "pictures of other numbers": ["left_001", "right_002"],
    "two actions": [f"{t}_{n}" for t, n in product(("walk", "run"), FIVE)],
}
VIDEOS: dict[str, tuple[Sequence[str], str]] = {
    "cameras and takes": (
        ["cam1_take1", "cam1_take2", "cam2_take1"],
        "cam1, cam2; take = take1, take2; one instant",
    ),
    "serial numbers": (
        [f"{a}.{c}" for a, c in product(("Eating", "Posing", "Smoking"), (54138969, 55011271))],
        "54138969, 55011271; take = Eating, Posing, Smoking; one instant",
    ),
}


def parsed(names: Sequence[str], *, stills: bool) -> str:
    parses = parse_names([Path("f", f"{name}.jpg") for name in names], Path("f"), stills=stills)
    return "" if (parse := choose(parses)) is None else f"{parse}"


@pytest.mark.parametrize(("names", "said"), IMAGES.values(), ids=IMAGES)
def test_names_of_images(names: Sequence[str], said: str) -> None:
    assert parsed(names, stills=True) == f"camera = {said}"


@pytest.mark.parametrize("names", QUESTIONS.values(), ids=QUESTIONS)
def test_names_that_have_several_readings_are_a_question(names: Sequence[str]) -> None:
    assert parsed(names, stills=True) == ""


@pytest.mark.parametrize(("names", "said"), VIDEOS.values(), ids=VIDEOS)
def test_names_of_videos(names: Sequence[str], said: str) -> None:
    assert parsed(names, stills=False) == f"camera = {said}"


def test_words_beside_cameras_and_instants_are_told() -> None:
    files = [Path(c, kind, f"{n}.png") for c, kind, n in product(LR, ("depth", "rgb"), FIVE)]
    parse = choose(parse_names(files, Path()))
    assert parse is not None
    assert {*parse.others} == {"depth", "rgb"}


@pytest.mark.parametrize(
    ("a", "b", "equal"),
    [
        ("day1_x", "day2_x", False),
        ("s1_a_walk", "s1_b_walk", True),
        ("1", "x1", False),
        ("cam1_x", "cam2_x", True),
        ("7_x", "8_x", False),
    ],
)
def test_takes_are_equal_but_for_the_cameras_own_words(a: str, b: str, *, equal: bool) -> None:
    names = take_names({"a": [Path(a), Path("y_1")], "b": [Path(b)]}) if a == "1" else {}
    names = names or take_names({"a": [Path(a)], "b": [Path(b)]})
    assert (names[Path(a)] == names[Path(b)]) == equal


def test_every_reading_of_a_question_is_a_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in").mkdir()
    for n, camera in product(FIVE, (0, 1)):
        (tmp_path / "in" / f"cal_{n}_{camera}.jpg").write_bytes(jpeg(n))
    out = ["--fps", "30", "--out", str(tmp_path / "out"), "--name", "s"]
    assert run(["sessions", "import", str(tmp_path / "in"), *out]) == ExitCode.BAD_INPUT
    said = capsys.readouterr().err
    given = [
        f"{camera}={tmp_path / 'in'}{'/' if '/' in said else chr(92)}cal_*_{camera}.jpg" for camera in (0, 1)
    ]
    assert "camera = 0, 1; 5 instants: capture-app sessions import" in said
    assert all(argument in said for argument in given)
    assert run(["sessions", "import", *given, *out]) == ExitCode.OK
    session = Session.open(tmp_path / "out" / "s")
    assert [camera.name for camera in session.manifest.cameras] == ["0", "1"]
    assert [len(images) for images in session.images_by_instant()] == [2] * 5


def test_pictures_of_one_instant_are_one_instant(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in").mkdir()
    for n in range(8):
        (tmp_path / "in" / f"cam{n + 1:02}.jpg").write_bytes(jpeg(n))
    (tmp_path / "in" / "notes.txt").write_text("x")
    assert (
        run(["sessions", "import", str(tmp_path / "in"), "--out", str(tmp_path), "--name", "s"])
        == ExitCode.OK
    )
    session = Session.open(tmp_path / "s")
    assert [len(images) for images in session.images_by_instant()] == [8]
    times = session.manifest.burst.common_times
    assert times is not None
    assert times.unknown
    assert "not used: notes.txt" in capsys.readouterr().err
