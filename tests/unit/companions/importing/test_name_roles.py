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
    "one number twice": (
        [f"{c}/{c}_{n:08}" for c, n in product(("00_00", "00_01"), FIVE)],
        "00_00, 00_01; 5 instants",
    ),
    "names of renders": (
        [f"{c}_{n:04}" for c, n in product(("Camera", "Camera.001"), FIVE)],
        "Camera, Camera.001; 5 instants",
    ),
    "no letters": ([f"{c}.img.{n}" for c, n in product("🔴🔵", FIVE)], "🔴, 🔵; 5 instants"),
    "serial numbers beside times of day": (
        [f"acA19__{c}__143002{n:03}_{n:04}" for c, n in product((22456780, 22456783), FIVE)],
        "22456780, 22456783; 5 instants",
    ),
    "serial numbers as many as instants": (
        [f"acA19__{c}__14300210{n}_{n:04}" for c, n in product((22456780, 22456783), (0, 1))],
        "22456780, 22456783; 2 instants",
    ),
    "times in ms": ([f"{c}_{1234567 + 40 * n}" for c, n in product("ab", FIVE)], "a, b; 5 instants"),
    "a counter of three digits": (
        [f"im{c}_{n:03}" for c, n in product((0, 1), FIVE)],
        "im0, im1; 5 instants",
    ),
    "folders of shots": ([f"shot{n}/c{c}" for n, c in product(FIVE, (0, 1))], "c0, c1; 5 instants"),
    "one photo of each phone": (
        ["anna/PXL_20240615_0930", "ben/IMG_20240615_0931"],
        "anna, ben; one instant",
    ),
    "folders that name takes and cameras": (
        [f"{t}_{c}/{n}" for t, c, n in product(("walk", "run"), LR, FIVE)],
        "left, right; take = walk, run; 5 instants",
    ),
    "folders that name cameras twice": (
        [f"{c}_{serial}/{n}" for (c, serial), n in product((("left", "77"), ("right", "78")), FIVE)],
        "left_77, right_78; 5 instants",
    ),
    "folders of takes": (
        [f"{t}/{c}{n}" for t, c, n in product("12", LR, FIVE)],
        "left, right; take = 1, 2; 5 instants",
    ),
}
QUESTIONS: dict[str, Sequence[str]] = {
    "a counter": [f"IMG_{n:04}" for n in FIVE],
    "a counter of a camera": [f"cam{n:04}" for n in FIVE],
    "a counter of a place": ["left1", "left2", "left3"],
    "two numbers": [f"cal_{n}_{c}" for n, c in product(FIVE, (0, 1))],
    "seconds and a counter": [f"20260131_{n // 2 + 142530}_{n % 2}" for n in range(6)],
    "folders of numbers": [f"{n:06}/{c}" for n, c in product(FIVE, (0, 1))],
    "pictures of other numbers": ["left_001", "right_002"],
    "folders of frames and numbers": [f"t{n:03}/{c}" for n, c in product(FIVE, (0, 1))],
    "two actions": [f"{t}_{n}" for t, n in product(("walk", "run"), FIVE)],
}
VIDEOS: dict[str, tuple[Sequence[str], str]] = {
    "reels and clips of cinema cameras": (
        [f"{c}001C{n:03}_240615_R1AB" for c, n in product("AB", (1, 2))],
        "A, B; take = C001, C002; one instant",
    ),
    "cameras of few digits": (
        [f"c{c}_{a}" for c, a in product((0, 1), "xyz")],
        "c0, c1; take = x, y, z; one instant",
    ),
    "takes that have a number or none": (
        [f"{a}.{c}" for a, c in product(("Eating 1", "Eating"), (54138969, 55011271, 58860488))],
        "54138969, 55011271, 58860488; take = Eating 1, Eating; one instant",
    ),
    "a place and a serial number": (
        [f"Walk0{t}_Miqus_{n}_{2309 + n}" for t, n in product((1, 2), (1, 2, 3))],
        "1, 2, 3; take = Walk01, Walk02; one instant",
    ),
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


def test_small_copies_and_pictures_of_the_set_are_not_cameras(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = [f"{camera}_{n:03}.jpg" for n, camera in product(FIVE, LR)]
    copies = [f"thumbs/{name}" for name in names] + [f"calibration/{name}" for name in names[:4]]
    for name in [*names, *copies, "setup.jpg"]:
        (tmp_path / "in" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "in" / name).write_bytes(jpeg(1))
    arguments = ["--fps", "30", "--out", str(tmp_path), "--name", "s"]
    assert run(["sessions", "import", str(tmp_path / "in"), *arguments]) == ExitCode.OK
    assert [len(images) for images in Session.open(tmp_path / "s").images_by_instant()] == [2] * 5
    said = capsys.readouterr().err
    assert "setup.jpg" in said
    assert "thumbs: 10 .jpg" in said


@pytest.mark.parametrize(
    ("names", "fine"), [(("a/1", "a/2", "b/7", "b/8"), True), (("a/1", "a/2", "b/7", "b/9"), False)]
)
def test_counters_that_never_meet_are_paired_by_place_if_none_has_a_gap(
    tmp_path: Path, names: Sequence[str], *, fine: bool
) -> None:
    for name in names:
        (tmp_path / "in" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "in" / f"{name}.jpg").write_bytes(jpeg(1))
    arguments = ["--fps", "30", "--out", str(tmp_path), "--name", "s"]
    assert run(["sessions", "import", str(tmp_path / "in"), *arguments]) == (
        ExitCode.OK if fine else ExitCode.BAD_INPUT
    )
    if fine:
        times = Session.open(tmp_path / "s").manifest.burst.common_times
        assert times is not None
        assert "paired by their place" in times.reason
