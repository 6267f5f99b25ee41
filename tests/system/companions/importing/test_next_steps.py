"""Each command that an import prints works: short and long films, one to three cameras, calibrated or not."""

import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import av
import pytest

from capture_app.cli import run as capture
from capture_app.common.errors import ExitCode
from capture_app.session.format.calibration import CameraCalibration
from reconstruction.cli import run as reconstruct
from tests.unit.reconstruction.conftest import FOCAL, HEIGHT, PERIOD_NS, WIDTH, Scene, make_view
from tests.unit.reconstruction.conftest import scene as scene
from tests.unit.reconstruction.time_offsets.cut_apart import Recorder, wander

CAMERAS = {
    "left": Recorder(make_view((-0.1, 0.0, 0.0), yaw=1.5), ppm=20),
    "right": Recorder(make_view((0.1, 0.01, 0.0), yaw=-1.5), start_s=0.4621, fps=30_000 / 1001, ppm=-15),
    "top": Recorder(make_view((0.0, -0.06, 0.0)), start_s=-0.3317),
}
SHORT_S, LONG_S = 1.6, 13.5
"""A sheet of both cameras at LONG_S would be taller than a JPEG can be."""
LONG = ("left", "right")
VALUES = {"PATH": "{}/lenses.toml", "DEG": "56.1"}
"""What a user has in the place of a word in capitals; 2 atan(WIDTH / 2 / FOCAL) is 56.1 degrees."""
Case = tuple[float, tuple[str, ...], bool]
CASES: dict[str, tuple[Case, list[str]]] = {
    "one camera": ((SHORT_S, ("left",), False), ["sheet"]),
    "one camera, long": ((LONG_S, ("left",), False), ["sheet"]),
    "two cameras": ((SHORT_S, LONG, False), ["from", "field-of-view", "time", "sheet"]),
    "two cameras, long": ((LONG_S, LONG, False), ["from", "field-of-view", "time", "sheet"]),
    "two cameras, calibrated": ((SHORT_S, LONG, True), ["compare"]),
    "two cameras, calibrated, long": ((LONG_S, LONG, True), ["time", "sheet"]),
    "three cameras": ((SHORT_S, tuple(CAMERAS), False), ["from", "time", "sheet"]),
    "three cameras, calibrated": ((SHORT_S, tuple(CAMERAS), True), ["time", "sheet"]),
}


@pytest.fixture(scope="module")
def films(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for each length, with the films of a board that wanders."""
    assert (WIDTH, FOCAL) == (320, 300.0)
    root = tmp_path_factory.mktemp("films")
    moving = replace(scene, boards=[*scene.boards[:-1], replace(scene.boards[-1], path=wander)])
    for seconds, names in ((SHORT_S, tuple(CAMERAS)), (LONG_S, LONG)):
        (root / str(seconds)).mkdir()
        for name in names:
            camera = CAMERAS[name]
            with av.open(str(root / str(seconds) / f"{name}.mp4"), "w") as container:
                stream = container.add_stream("libx264", rate=30)
                stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
                stream.options = {"crf": "10", "preset": "ultrafast"}
                for number in range(int(seconds * camera.fps)):
                    periods = camera.true_s(number / camera.fps) * 1e9 / PERIOD_NS
                    image, _, _ = moving.look(camera.view, periods)
                    container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="gray")))
                container.mux(stream.encode(None))
    return root


def write_lenses(path: Path, names: tuple[str, ...]) -> None:
    """Write the cameras as Caliscope's TOML."""
    tables = []
    for name in names:
        view: CameraCalibration = CAMERAS[name].view.to_calibration()
        rotation = [list(row) for row in view.rotation]
        tables.append(
            f"[{name}]\nsize = [{view.width}, {view.height}]\n"
            f"matrix = [[{view.fx}, 0, {view.cx}], [0, {view.fy}, {view.cy}], [0, 0, 1]]\n"
            f"distortions = [0, 0, 0, 0, 0]\nrotation = {rotation}\ntranslation = {list(view.translation)}\n"
        )
    path.write_text("\n".join(tables))


def run(command: str, folder: Path) -> int:
    for word, value in VALUES.items():
        command = command.replace(word, shlex.quote(value.format(folder)))
    program, *arguments = shlex.split(command)
    return {"capture-app": capture, "reconstruct": reconstruct}[program](arguments)


@pytest.mark.parametrize("name", CASES)
def test_each_command_that_an_import_prints_works(
    name: str,
    films: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (seconds, cameras, calibrated), expected = CASES[name]
    monkeypatch.chdir(tmp_path)
    write_lenses(tmp_path / "lenses.toml", cameras)
    sources = [f"{camera}={films / str(seconds) / camera}.mp4" for camera in cameras]
    lenses = ["--calibration", str(tmp_path / "lenses.toml")] if calibrated else []
    assert capture(["sessions", "import", *sources, *lenses, "--name", "s", "--out", "my shoot"]) == 0
    lines = capsys.readouterr().err.splitlines()
    steps = [line for line in lines if line.startswith(("to ", "next: "))]
    assert steps[-1].startswith("next: ")
    # No board is in these films.
    boards = [step for step in steps if "--from board" in step]
    assert len(boards) == (len(cameras) > 1 and not calibrated)
    steps = [step for step in steps if step not in boards]
    commands = [step.partition(": ")[2] for step in steps]
    for step, command, word in zip(steps, commands, expected, strict=True):
        assert word in command
        # Each starts from the session as it was imported.
        shutil.copytree("my shoot/s", "as it was")
        if " time " in command and not calibrated:
            assert run(commands[0], tmp_path) == ExitCode.OK
        assert run(command, tmp_path) == ExitCode.OK, (command, capsys.readouterr().err)
        if "without --from" in step:
            again = command.replace("--from PATH", "--replace")
            assert run(again, tmp_path) == ExitCode.OK, (again, capsys.readouterr().err)
        shutil.rmtree("my shoot/s")
        Path("as it was").rename("my shoot/s")
    said = capsys.readouterr().err
    assert ("instants is shown" in said) == (seconds == LONG_S)
