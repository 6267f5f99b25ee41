"""A newcomer's three clips of a wall and a board: nothing is said by a calibration that is guessed."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import pytest

from capture_app.session.reading.reader import Session

PROGRAMS = {"capture-app": "capture_app.cli", "reconstruct": "reconstruction.cli"}


def run(folder: Path, program: str, *arguments: str) -> str:
    call = [sys.executable, "-m", PROGRAMS[program], *arguments]
    done = subprocess.run(call, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def test_own_clips(shared: Path, tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location("cases_make", shared / "cases" / "make.py")
    assert spec is not None
    assert spec.loader is not None
    make = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make)
    make.main([str(tmp_path), "own-clips"])
    expected = json.loads((shared / "cases" / "expected.json").read_text())["own-clips"]
    printed = run(tmp_path, "capture-app", "sessions", "import", "own-clips/clips", "--out", "out")
    times = Session.open(tmp_path / "out" / "clips").manifest.burst.common_times
    assert times is not None
    for name, true_ms in expected["truth_offsets_ms"].items():
        of = times.cameras[name]
        assert (of.offset_ns or 0) / 1e6 == pytest.approx(true_ms, abs=2)
    assert "0 missing" in printed
    asked = ("time", "out/clips"), ("compare", "out/clips", "--study", "panorama", "--out", "report")
    said = [run(tmp_path, "reconstruct", *arguments) for arguments in asked]
    # Each finds the calibration anew, and the same one.
    first, second = ([line for line in text.splitlines() if "this one was found" in line] for text in said)
    assert first == second
    printed += "".join(said) + (tmp_path / "report" / "report.html").read_text()
    assert "off by up to" not in printed
    for text in expected["never_say"]:
        assert text not in printed
