"""The scripts of docs/examples run as they are, from the project's folder."""

import contextlib
import io
import re
import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from capture_app import open_session
from tests.project import JUMPER, ROOT

FOLDER = ROOT / "docs" / "examples"


def run(name: str, *arguments: str | Path) -> str:
    command = [sys.executable, FOLDER / name, *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return done.stdout


@pytest.fixture
def run_here(monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """The same in this process, which has imported what the script imports."""

    def run(name: str, *arguments: str | Path) -> str:
        monkeypatch.chdir(ROOT)
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            runpy.run_path(str(FOLDER / name), run_name="__main__")
        return printed.getvalue()

    return run


def test_a_moving_point_is_right_only_when_synchronized(run_here: Callable[..., str]) -> None:
    synced, late = run_here("triangulate_point.py").splitlines()
    depth_m, moving = open_session(JUMPER).frame("cam00", 1).truth()
    x, y, *place = map(float, re.findall(r"-?\d+\.\d*", synced))
    assert moving[round(y), round(x)]
    assert place[2] == pytest.approx(float(depth_m[round(y), round(x)]), rel=0.02)
    x, y, *place = map(float, re.findall(r"-?\d+\.\d*", late))
    assert place[2] != pytest.approx(float(depth_m[round(y), round(x)]), rel=0.05)


def test_each_example_is_tried_and_linked() -> None:
    page = (ROOT / "docs" / "python.md").read_text()
    tried = "".join(path.read_text() for path in (ROOT / "tests").glob("*/documentation/test_examples.py"))
    for path in FOLDER.glob("*.py"):
        assert f"examples/{path.name}" in page
        assert re.search(rf'run(_here)?\("{path.name}"', tried)
