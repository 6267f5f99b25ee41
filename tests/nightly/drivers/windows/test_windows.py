"""simulshot on Windows: a real CPython for Windows under Wine, with nothing of the product replaced.

`make test KIND=windows` runs it. Wine is kinder than Windows: it renames folders with open files, and its
timers have a millisecond.
"""

import hashlib
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.nightly.drivers.windows.windows_python import CHECKOUT, DATA, WindowsPython, make_windows_python
from tests.project import JUMPER, ROOT, SAMPLES

pytestmark = pytest.mark.timeout(1500)

ROOMS = ("common", "session", "sync", "net", "trust", "companions/importing")
OF_THE_KIT = "test_plugins or test_optional_packages"
"""Its library of Python is older than its interpreter: `importlib.invalidate_caches` fails there."""
SAMPLE = rf"{CHECKOUT}\sample_sessions\jumper"
READY_S = 60


@pytest.fixture(scope="module")
def windows(tmp_path_factory: pytest.TempPathFactory) -> WindowsPython:
    """The programs of this checkout under Windows."""
    return make_windows_python(tmp_path_factory.mktemp("windows"))


def capture_app(*arguments: str) -> str:
    """Run a command of this machine to its end."""
    command = [sys.executable, "-m", "capture_app.cli", *arguments]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stderr
    return run.stdout + run.stderr


def until(what: str, is_so: Callable[[], bool], log: Path) -> None:
    """Wait for something; if it does not come, the log says why."""
    end_s = time.monotonic() + READY_S
    while not is_so():
        assert time.monotonic() < end_s, f"waited {READY_S} s for {what}: {log.read_text()[-2000:]}"
        time.sleep(0.5)


def test_unit_tests_of_portable_rooms(windows: WindowsPython) -> None:
    script = rf"{CHECKOUT}\tests\nightly\drivers\windows\unit_tests.py"
    rooms = [f"tests/unit/{room}" for room in ROOMS]
    options = ("-q", "-p", "no:cacheprovider", "--timeout", "120", "-k", f"not ({OF_THE_KIT})")
    # The tests themselves read and write files without naming UTF-8.
    said = windows.run("python", script, *options, *rooms, timeout_s=900, variables={"PYTHONUTF8": "1"})
    passed = re.search(r"(\d+) passed", said)
    assert passed is not None
    assert int(passed[1]) > 1200


def test_sessions_of_linux_are_sound_there(windows: WindowsPython) -> None:
    for name in sorted(path.name for path in SAMPLES.iterdir() if (path / "session.json").is_file()):
        said = windows.run("capture-app", "sessions", "verify", rf"{CHECKOUT}\sample_sessions\{name}")
        assert "are intact" in said, said


def test_depth_is_that_of_linux_to_the_byte(windows: WindowsPython, tmp_path: Path) -> None:
    windows.run("reconstruct", "stereo", SAMPLE, "--instant", "3", "--out", rf"{DATA}\depth")
    command = [sys.executable, "-m", "reconstruction.cli", "stereo", str(JUMPER), "--instant", "3"]
    subprocess.run([*command, "--out", str(tmp_path / "depth")], cwd=ROOT, check=True, capture_output=True)
    there, here = windows.data / "depth" / "depth.tiff", tmp_path / "depth" / "depth.tiff"
    assert hashlib.sha256(there.read_bytes()).digest() == hashlib.sha256(here.read_bytes()).digest()


def test_a_comparison_says_what_it_says_on_linux(windows: WindowsPython, tmp_path: Path) -> None:
    asked = ("--offset-ms", "66", "--study", "stereo")
    said = windows.run("reconstruct", "compare", SAMPLE, *asked, "--out", rf"{DATA}\compare", timeout_s=600)
    command = [sys.executable, "-m", "reconstruction.cli", "compare", str(JUMPER), *asked]
    run = subprocess.run(
        [*command, "--out", str(tmp_path / "compare")], cwd=ROOT, check=True, capture_output=True, text=True
    )
    ours, theirs = (
        next(line for line in text.splitlines() if line.startswith("When both pictures"))
        for text in (run.stdout, said)
    )
    assert theirs.partition(" cam01 is")[0] == ours.partition(" cam01 is")[0]
    # Of OpenCV's tracks the last digits differ by the build.
    assert re.sub(r"\d+\.\d+", "N", theirs) == re.sub(r"\d+\.\d+", "N", ours)


def test_the_demo(windows: WindowsPython) -> None:
    said = windows.run("capture-app", "demo", "--out", rf"{DATA}\demo", timeout_s=600)
    assert "When both pictures show the same instant" in said
    assert (windows.data / "demo" / "compare" / "report.html").is_file()


def test_a_rig_in_the_background_is_listed_takes_and_stops(windows: WindowsPython) -> None:
    script = rf"{CHECKOUT}\tests\nightly\drivers\windows\background_rig.py"
    said = windows.run("python", script, "47911", rf"{DATA}\rig", "5")
    assert "no rig runs on this machine" in said
    assert "all 10 images are intact" in said


def test_a_recording_of_two_windows_nodes_and_one_of_linux(
    windows: WindowsPython, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SIMULSHOT_OPEN", "1")
    port, sessions = "47912", tmp_path / "sessions"
    leader = ("--leader", f"127.0.0.1:{port}")
    lead = ["leader", "--open", "--host", "127.0.0.1", "--port", port, "--sessions", str(sessions)]
    node = ("node", "--open", "--camera", "sim:pi", *leader)
    log = tmp_path / "linux.log"
    output = log.open("ab")
    ours = [
        subprocess.Popen(
            [sys.executable, "-m", "capture_app.cli", *arguments],
            cwd=ROOT,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        for arguments in (lead, [*node, "--name", "linux"])
    ]
    theirs = [windows.start("capture-app", *node, "--name", name) for name in ("one", "other")]
    try:
        until("three cameras", lambda: "3 cameras ready" in _status(leader), log)
        capture_app("record", *leader, "--seconds", "5", "--name", "film", "--max-missing", "100")
        # It is sound here, and there.
        assert "are intact" in capture_app("sessions", "verify", str(sessions / "film-001"))
        subprocess.run(["cp", "-r", sessions / "film-001", windows.data / "film"], check=True)
        assert "are intact" in windows.run("capture-app", "sessions", "verify", rf"{DATA}\film")
    finally:
        output.close()
        for process in reversed(ours):
            process.send_signal(signal.SIGTERM)
            process.wait(60)
        for node_there in theirs:
            node_there.stop()


def _status(leader: tuple[str, ...]) -> str:
    command = [sys.executable, "-m", "capture_app.cli", "status", *leader]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False).stdout
