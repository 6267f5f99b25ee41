"""`capture-app doctor` looks a machine over, prints what it finds, and fails where there is a problem."""

from pathlib import Path

import msgspec
import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from tests.project import SAMPLES


def test_a_report_holds_what_was_found_and_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    report, panel = tmp_path / "report.json", SAMPLES / "led_panel"
    asked = ("--report", str(report), "--camera", "nothing:0", "--panel", str(panel))
    run(("doctor", "--spool", str(tmp_path / "spool"), *asked))
    told = msgspec.json.decode(report.read_bytes())
    assert {"version", "clock", "disk"} <= {finding["check"] for finding in told["doctor"]}
    assert "capture-app: error:" in told["cameras"]["nothing:0"]["error"]
    assert told["panel"]["pictures"]
    capfd.readouterr()
    assert run(("doctor", "--camera", "nothing:0")) == ExitCode.USAGE
    assert "needs --report" in capfd.readouterr().err
