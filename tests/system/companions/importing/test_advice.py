"""What a refusal advises works: each command is run again as it says."""

import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.session.reading.reader import Session
from tests.unit.companions.importing.numbered_video import write_video
from tests.unit.companions.importing.strangers import LAMP, A, B
from tests.unit.plugins.footage.cut_apart import Take
from tests.unit.session.conftest import jpeg

Advised = Callable[[str, list[str]], list[str]]
"""Returns the arguments that a refusal advises, given it and the arguments that it refused."""


def images(folder: Path, name: Callable[[int], str]) -> None:
    for camera in ("left", "right"):
        (folder / camera).mkdir(parents=True)
        for number in range(3):
            (folder / camera / f"{name(number)}.jpg").write_bytes(jpeg(number))


def phones(folder: Path, take: Take, codes: tuple[str, str] = ("", "")) -> None:
    for phone, code in zip((A, B), codes, strict=True):
        replace(phone, timecode=code).record(take, folder / f"{phone.name}.mov", 5, sound=False)


def numbered(folder: Path) -> None:
    images(folder, "{:04d}".format)


def named_by_times(folder: Path) -> None:
    images(folder, lambda number: f"1305031102.{100_000 + 40_000 * number}")


def one_folder(folder: Path) -> None:
    folder.mkdir(parents=True)
    for camera in ("L", "R"):
        for number in range(3):
            (folder / f"{camera}_{number:04}.jpg").write_bytes(jpeg(number))


def two_rates(folder: Path) -> None:
    for name, step_us in (("left", 40_000), ("right", 20_000)):
        write_video(folder / f"{name}.mp4", [step_us * n for n in range(12)])


def separate_clocks(folder: Path) -> None:
    numbered(folder / "cameras")
    rows = [f"{name},{n},{at + n / 10}" for name, at in (("left", 20), ("right", 900)) for n in range(3)]
    (folder / "ticks.csv").write_text("\n".join(["camera,frame,time", *rows]))


def lenses(folder: Path) -> None:
    numbered(folder / "cameras")
    lens = "size = [16, 12]\nmatrix = [[9, 0, 8], [0, 9, 6], [0, 0, 1]]\ndistortions = [0, 0, 0, 0]\n"
    (folder / "camera_array.toml").write_text(f"[left]\n{lens}[right]\n{lens}")


def lone_lamp(folder: Path) -> None:
    phones(folder, LAMP)


def timecodes(folder: Path) -> None:
    phones(folder, Take(), ("10:00:00:00", "10:00:01:07"))


def option(pattern: str) -> Advised:
    """The option that the refusal names, with a value of its own kind."""
    values = {"--fps": ["--fps", "30"], "--time-shift-ms": ["--time-shift-ms", "right=-880000"]}

    def advised(said: str, refused: list[str]) -> list[str]:
        found = re.search(pattern, said)
        assert found is not None, said
        return [*refused, *values.get(found[1], shlex.split(found[1]))]

    return advised


def without(name: str, values: int) -> Advised:
    def advised(said: str, refused: list[str]) -> list[str]:
        assert re.search(f"(without|leave out) {name}", said), said
        at = refused.index(name)
        return refused[:at] + refused[at + values + 1 :]

    return advised


CASES: dict[str, tuple[Callable[[Path], None], list[str], Advised]] = {
    "images without times": (numbered, ["{}"], option("add their rate, (--fps)")),
    "images named by times": (named_by_times, ["{}"], option("take them: (--times name)")),
    "images of two cameras in one folder": (one_folder, ["{}"], option("add their rate, (--fps)")),
    "one rate for two": (two_rates, ["{}", "--fps", "30"], without("--fps", 1)),
    "one clock for two rates": (two_rates, ["{}", "--fps", "30"], option("own times; (--synchronized)")),
    "clocks that never meet": (
        separate_clocks, ["{}/cameras", "--timestamps", "{}/ticks.csv"],
        option("(--time-shift-ms) CAMERA=MS"),
    ),
    "lenses without poses": (
        lenses, ["{}/cameras", "--fps", "30", "--calibration", "{}/camera_array.toml"],
        without("--calibration", 1),
    ),
    "a lone lamp": (lone_lamp, ["{}"], option("if it is right: (--align flash)")),
    "timecodes": (timecodes, ["{}"], option("if it is right: (--align timecode)")),
}  # fmt: skip
NOT_REFUSED = ("a lone lamp", "timecodes")


@pytest.mark.parametrize("name", CASES)
def test_what_is_advised_works(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make, arguments, advised = CASES[name]
    make(tmp_path / "my shoot")
    filled = [argument.format(tmp_path / "my shoot") for argument in arguments]
    to = ["--name", "s", "--out"]
    code = run(["sessions", "import", *filled, *to, str(tmp_path / "first")])
    assert code == (ExitCode.OK if name in NOT_REFUSED else ExitCode.BAD_INPUT)
    printed = capsys.readouterr()
    again = advised(printed.out + printed.err, filled)
    assert run(["sessions", "import", *again, *to, str(tmp_path / "again")]) == ExitCode.OK
    times = Session.open(tmp_path / "again" / "s").manifest.burst.common_times
    assert times is not None
    assert times.unknown == (name == "one rate for two")
