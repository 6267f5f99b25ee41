"""The scripts of docs/examples run as they are, from the project's folder."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from capture_app import open_session
from tests.documentation.pages import ROOT

FOLDER = ROOT / "docs" / "examples"


def run(name: str, *arguments: str | Path) -> str:
    command = [sys.executable, FOLDER / name, *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return done.stdout


def test_error_bars_of_each_camera() -> None:
    lines = run("error_bars.py").splitlines()
    assert [line.partition(":")[0] for line in lines] == ["cam00", "cam01", "cam04", "cam05", "cam06"]
    for line in lines:
        residual, error, bound = map(int, re.findall(r"(\d+) us", line))
        assert residual < error < bound


def test_a_point_is_as_far_away_as_the_truth_says() -> None:
    x, y, *place = map(float, re.findall(r"-?\d+\.\d*", run("triangulate_point.py")))
    depth_m, _ = open_session(ROOT / "sample_sessions" / "jumper").cameras["cam00"].frames[0].truth()
    assert place[2] == pytest.approx(float(depth_m[round(y), round(x)]), rel=0.02)


@pytest.mark.slow
def test_a_burst_of_simulated_cameras(tmp_path: Path) -> None:
    assert "3 cameras, 5 instants" in run("take_burst.py", tmp_path)


def test_each_example_is_tried_and_linked() -> None:
    page, tried = (ROOT / "docs" / "python.md").read_text(), Path(__file__).read_text()
    for path in FOLDER.glob("*.py"):
        assert f"examples/{path.name}" in page
        assert f'run("{path.name}"' in tried
