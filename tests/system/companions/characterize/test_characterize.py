"""What is measured of simulated cameras, whose every property is known; in stepped time."""

import json
from pathlib import Path

import pytest

from capture_app.cli import run

pytestmark = pytest.mark.virtual


def test_the_command_prints_what_it_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    words = ["cameras", "characterize", "sim:webcam,start_ms=1", "--seconds", "1", "--starts", "1"]
    assert run(words) == 0
    out = capsys.readouterr().out
    for said in (
        "Simulated USB webcam",
        "frames/s",
        "exact, by construction",
        "saved in this user's profiles",
    ):
        assert said in out
    assert run([*words, "--starts", "0", "--no-save", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["camera"]["model"], found["saved"]) == ("Simulated USB webcam", False)
