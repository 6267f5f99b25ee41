"""Each kind of file that is read, spoiled in each way: an error line with a remedy, or a success."""

import os
import shutil
import signal
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture_app.cli import run as capture_app
from capture_app.common.errors import ExitCode
from capture_app.session.format.calibration import Calibration, CameraCalibration
from capture_app.session.format.manifest import BurstRecord
from capture_app.session.writing.session_writer import SessionWriter
from reconstruction.cli import run as reconstruct
from tests.unit.plugins.programs.test_calibrations import QCA, D, K, R, T
from tests.unit.plugins.programs.test_phones import recsync, shot
from tests.unit.plugins.programs.test_rig_calibrations import opencap
from tests.unit.session.conftest import INSTANTS, camera_record, jpeg

SIZE = 64, 48
PHONES = ("libsoftwaresync", "recsync")
IN_SYSTEM = ("colmap", "mp4", "recsync")
"""The formats that are tried with every change; tests/nightly tries the others."""
EXPORTS = ("caliscope", "colmap", "easymocap", "freemocap", "mcap", "mp4", "nerfstudio")
SECONDS = 30


def as_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def as_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def as_loop(path: Path) -> None:
    path.unlink()
    path.symlink_to(path)


def written(change: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    return lambda path: (path.write_bytes(change(path.read_bytes())), None)[1]


def deep(_: bytes) -> bytes:
    return b'{"a":' * 100_000


def numbers(data: bytes, number: bytes) -> bytes:
    """Every other digit is another number."""
    return b"".join(number if 48 <= of < 58 and place % 2 else bytes([of]) for place, of in enumerate(data))


SPOILED: dict[str, Callable[[Path], None]] = {
    "missing": Path.unlink,
    "empty": written(lambda _: b""),
    "half": written(lambda data: data[: len(data) // 2]),
    "zeros": written(lambda data: bytes(len(data))),
    "text": written(lambda _: b"hello\n"),
    "not UTF-8": written(lambda data: data[:-2] + b"\xff\xfe\n"),
    "a list": written(lambda _: b"[1, 2]"),
    "deep": written(deep),
    "a long line": written(lambda _: b"a," * 200_000),
    "NaN": written(lambda data: numbers(data, b"NaN")),
    "huge numbers": written(lambda data: numbers(data, b"9" * 30)),
    "a pipe": as_pipe,
    "a folder": as_folder,
    "a loop": as_loop,
}


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibrated session of two cameras, and its exports beside it."""
    root = tmp_path_factory.mktemp("sound")
    writer = SessionWriter.create(root, "sound")
    for number, instant_ns in enumerate(INSTANTS):
        for camera in ("left", "right"):
            writer.add_image(
                jpeg(number, *SIZE), camera=camera, instant=number, leader_ns=instant_ns, residual_ns=0
            )
    upright = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    lens: dict[str, Any] = {"width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 32.0, "cy": 24.0}
    cameras = {
        name: CameraCalibration(**lens, rotation=upright, translation=(x, 0.0, 0.0))
        for name, x in (("left", 0.0), ("right", -0.1))
    }
    writer.set_calibration(Calibration(cameras=cameras, source="board"))
    records = [camera_record(name, width=SIZE[0], height=SIZE[1]) for name in cameras]
    session = writer.finish(records, BurstRecord(instants_ns=INSTANTS, period_ns=33_000_000))
    for name in EXPORTS:
        arguments = ("sessions", "export", str(session.folder), "--to", name, "--out", str(root / name))
        assert capture_app(arguments) == 0
    for late_ns, phone in enumerate(("a", "b")):
        for number in range(2):
            time, folder = f"20260131_1425{number:02}_123", root / "libsoftwaresync" / phone / f"shot{number}"
            shot(folder, time, 10**12 + 2 * 10**9 * number + late_ns, nv21=phone == "b")
        recsync(root / "recsync" / phone, [33_333 * n for n in range(6)])
    lenses = root / "lenses"
    opencap(lenses)
    (lenses / "room.qca.txt").write_text(QCA.format(name="left", x=1000))
    for suffix in (".yml", ".xml", ".json"):
        storage = cv2.FileStorage(str(lenses / f"storage{suffix}"), cv2.FILE_STORAGE_WRITE)
        for key, value in {"M1": K, "D1": D, "M2": K, "D2": D, "R": R, "T": T}.items():
            storage.write(key, value)
        storage.release()
    np.savez(lenses / "lens.npz", K=K, D=D)
    rows = [f"{camera},{n},{n / 30}" for camera in ("left", "right") for n in range(3)]
    (lenses / "times.csv").write_text("camera,frame,time\n" + "\n".join(rows) + "\n")
    return root


def one_of_each(folder: Path) -> Iterator[Path]:
    """The first file of each name without its digits and folder."""
    seen = set()
    for path in sorted(folder.rglob("*")):
        name = "".join(of for of in path.name if not of.isdigit())
        if path.is_file() and name not in seen:
            seen.add(name)
            yield path.relative_to(folder)


def told(
    program: Callable[[list[str]], int], arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> str:
    """Run a command line; return what is wrong with how it ends."""

    def ring(*_: object) -> None:
        raise TimeoutError(f"not done after {SECONDS} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(SECONDS)
    try:
        code = program(arguments)
    except BaseException:
        return "raised " + traceback.format_exc().splitlines()[-1]
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    said = capsys.readouterr().err.strip()
    last = said.splitlines()[-1] if said else ""
    if "Traceback" in said or code not in (ExitCode.OK, ExitCode.BAD_INPUT, ExitCode.INCOMPLETE):
        return f"exit {code}: {last}"
    return "" if code == ExitCode.OK or last.endswith(")") else f"no remedy: {last}"


def check(
    root: Path, file: Path, out: Path, commands: dict[str, Callable[[str, str], list[str]]],
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    wrong = {}
    for name, spoil in SPOILED.items():
        for command, arguments in commands.items():
            odd = out / "odd"
            shutil.copytree(root, odd)
            spoil(odd / file)
            capsys.readouterr()
            program = reconstruct if command == "stereo" else capture_app
            if fault := told(program, arguments(str(odd), str(out / "out")), capsys):
                wrong[f"{file}, {name}, {command}"] = fault
            shutil.rmtree(odd)
            shutil.rmtree(out / "out", ignore_errors=True)
    assert not wrong, "\n".join(f"{name}: {fault}" for name, fault in wrong.items())


@pytest.mark.timeout(900)
@pytest.mark.parametrize("export", IN_SYSTEM)
def test_an_export_with_a_spoiled_file_is_imported_or_refused_with_a_remedy(
    export: str, sound: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    check_export(export, sound, tmp_path, capsys)


def check_export(export: str, sound: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Spoil each kind of file of an export, and import it."""
    commands = {"import": lambda odd, out: ["sessions", "import", odd, "--name", "x", "--out", out]}
    for file in one_of_each(sound / export):
        check(sound / export, file, tmp_path, commands, capsys)


@pytest.mark.timeout(900)
def test_a_spoiled_calibration_or_table_is_read_or_refused_with_a_remedy(
    sound: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = str(sound / "sound/images/rig1")
    for file in one_of_each(sound / "lenses"):
        option = "--timestamps" if file.suffix == ".csv" else "--calibration"
        options = ["--name", "x", *([] if file.suffix == ".csv" else ["--fps", "30"]), option]

        def read(odd: str, out: str, options: list[str] = options, file: Path = file) -> list[str]:
            return ["sessions", "import", images, *options, f"{odd}/{file}", "--out", out]

        check(sound / "lenses", file, tmp_path, {"import": read}, capsys)


@pytest.mark.timeout(900)
def test_a_session_with_a_spoiled_file_is_read_or_refused_with_a_remedy(
    sound: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    commands = {
        "verify": lambda odd, _: ["sessions", "verify", odd],
        "show": lambda odd, _: ["sessions", "show", odd],
        "export": lambda odd, out: ["sessions", "export", odd, "--to", "colmap", "--out", out],
        "repair": lambda odd, _: ["sessions", "repair", odd],
        "stereo": lambda odd, out: ["stereo", odd, "--out", out],
    }
    for file in one_of_each(sound / "sound"):
        check(sound / "sound", file, tmp_path, commands, capsys)
