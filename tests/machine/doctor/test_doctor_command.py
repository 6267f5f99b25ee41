"""`capture-app doctor` looks a machine over, prints what it finds, and fails where there is a problem."""

from pathlib import Path

import msgspec
import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from tests.net.ports import closed_port


def test_a_leader_out_of_reach_is_a_problem_in_json_and_for_people(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    leader = ("--leader", str(closed_port()), "--spool", str(tmp_path / "spool"))
    assert run(("doctor", *leader, "--json")) == ExitCode.FAILURE
    printed, said = capfd.readouterr()
    assert "1 problem found" in said
    told = msgspec.json.decode(printed)
    assert told["problems"] == 1
    found = {finding["check"]: finding for finding in told["findings"]}
    assert {"version", "trust", "leader", "discovery", "firewall", "clock", "disk", "cameras"} <= set(found)
    assert found["leader"]["grade"] == "problem"
    assert "start it there with: capture-app" in found["leader"]["remedy"]

    assert run(("doctor", *leader)) == ExitCode.FAILURE
    printed, _ = capfd.readouterr()
    assert "problem  leader     127.0.0.1 is reachable, but no leader listens" in printed
    assert "→ start it there with: capture-app" in printed


@pytest.mark.slow
def test_a_report_holds_what_was_found_and_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    report, panel = tmp_path / "report.json", Path(__file__).parents[3] / "sample_sessions" / "led_panel"
    asked = ("--report", str(report), "--camera", "nothing:0", "--panel", str(panel))
    run(("doctor", "--spool", str(tmp_path / "spool"), *asked))
    told = msgspec.json.decode(report.read_bytes())
    assert {"version", "clock", "disk"} <= {finding["check"] for finding in told["doctor"]}
    assert "capture-app: error:" in told["cameras"]["nothing:0"]["error"]
    assert told["panel"]["pictures"]
    capfd.readouterr()
    assert run(("doctor", "--camera", "nothing:0")) == ExitCode.USAGE
    assert "require --report" in capfd.readouterr().err
