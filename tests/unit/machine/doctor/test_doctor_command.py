"""`capture-app doctor` looks a machine over, prints what it finds, and fails where there is a problem."""

from pathlib import Path

import msgspec
import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from tests.unit.net.ports import closed_port


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
