"""A node as a service: the file that systemd gets, what is asked of it, and where it cannot be."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.machine.boot_service import BootService

NODE = ("node", "--name", "left", "--camera", "sim:webcam", "--leader", "192.168.1.20")
STAND_IN = """#!/bin/sh
echo "$(basename "$0") $*" >>"$LOG"
case "$*" in
  *--property=Linger*) echo "Linger=$LINGER" ;;
  enable-linger) exit "$REFUSED" ;;
  *"$FAILS"*) echo "Failed to connect to bus" >&2; exit 1 ;;
esac
"""


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user of a machine with systemd; what is asked of it, a line each."""
    for name in ("systemctl", "loginctl"):
        (tmp_path / name).write_text(STAND_IN)
        (tmp_path / name).chmod(0o755)
    folders = {"PATH": f"{tmp_path}:/usr/bin:/bin", "XDG_CONFIG_HOME": tmp_path / "config"}
    systemd = {"LOG": tmp_path / "log", "LINGER": "no", "REFUSED": "0", "FAILS": "nothing"}
    for name, value in {**folders, **systemd, "LOGNAME": "root"}.items():
        monkeypatch.setenv(name, str(value))
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    return tmp_path / "log"


def unit_of(log: Path) -> Path:
    return log.parent / "config" / "systemd" / "user" / "simulshot-left.service"


def test_a_node_is_shown_written_and_started(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*NODE, "--at-boot", "--yes"]) == ExitCode.OK
    printed, text = capsys.readouterr(), unit_of(log).read_text()
    assert printed.out == f"# {unit_of(log)}\n{text}\n"
    assert "journalctl --user -u simulshot-left -f" in printed.err
    command = "capture_app.cli node --name left --camera sim:webcam --leader 192.168.1.20:47010"
    assert f"ExecStart={sys.executable} -P -m {command}\n" in text
    unit = "simulshot-left"
    assert log.read_text().splitlines() == [
        "systemctl --user daemon-reload",
        f"systemctl --user enable {unit}",
        f"systemctl --user restart {unit}",
        *(f"loginctl {line}" for line in ("show-user root --property=Linger", "enable-linger")),
    ]
    assert run([*NODE, "--not-at-boot"]) == ExitCode.OK
    assert not unit_of(log).exists()
    assert f"systemctl --user disable --now {unit}" in log.read_text()
    assert run([*NODE, "--not-at-boot"]) == ExitCode.BAD_INPUT
    assert "is not set to start with this machine" in capsys.readouterr().err


def test_a_node_that_accepts_any_machine_does_so_at_boot(log: Path) -> None:
    assert run([*NODE, "--open", "--at-boot", "--yes"]) == ExitCode.OK
    assert "--leader 192.168.1.20:47010 --open\n" in unit_of(log).read_text()


def test_nothing_is_written_unasked(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*NODE, "--at-boot"]) == ExitCode.NOT_AVAILABLE
    printed = capsys.readouterr()
    assert "ExecStart=" in printed.out
    assert "--yes" in printed.err
    assert not unit_of(log).exists()
    assert not log.exists()


@pytest.mark.parametrize("earlier", [None, "another node\n"])
def test_a_systemd_that_refuses_leaves_things_as_they_were(
    log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], earlier: str | None
) -> None:
    monkeypatch.setenv("FAILS", "daemon-reload")
    if earlier is not None:
        unit_of(log).parent.mkdir(parents=True)
        unit_of(log).write_text(earlier)
    assert run([*NODE, "--at-boot", "--yes"]) == ExitCode.NOT_AVAILABLE
    assert "systemctl --user daemon-reload: Failed to connect to bus (log in as" in capsys.readouterr().err
    assert (unit_of(log).read_text() if unit_of(log).exists() else None) == earlier


def test_who_may_not_linger_is_told_the_line(
    log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("REFUSED", "1")
    assert run([*NODE, "--at-boot", "--yes"]) == ExitCode.OK
    assert "sudo loginctl enable-linger root" in capsys.readouterr().err
    monkeypatch.setenv("LINGER", "yes")
    assert run([*NODE, "--at-boot", "--yes"]) == ExitCode.OK
    assert "sudo" not in capsys.readouterr().err


def test_a_machine_without_systemd(
    log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path / "nothing"))
    assert run([*NODE, "--at-boot", "--yes"]) == ExitCode.NOT_AVAILABLE
    assert "systemd is not available" in capsys.readouterr().err
    assert not unit_of(log).exists()


@pytest.mark.parametrize("user", [0, 1000])
def test_systemd_reads_it_as_it_is_meant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, user: int) -> None:
    verifier = shutil.which("systemd-analyze")
    if verifier is None:
        pytest.skip("no systemd-analyze here")
    monkeypatch.setattr(os, "geteuid", lambda: user)
    service = BootService("a b", ("node", "--spool", '100 % of "$HOME" \\'))
    assert service.path.parent == Path("/etc/systemd/system") or user
    file = tmp_path / "simulshot-node.service"
    file.write_text(service.text())
    done = subprocess.run([verifier, "verify", "--man=no", file], capture_output=True, text=True, check=False)
    assert "simulshot" not in done.stderr, done.stderr
    assert '"100 %% of \\"$$HOME\\" \\\\"\n' in file.read_text()


def test_names_without_a_letter_of_ascii_are_services_of_their_own(log: Path) -> None:
    for name in ("カメラ左", "カメラ右", "カメラ左"):
        assert run(["node", "--name", name, *NODE[3:], "--at-boot", "--yes"]) == ExitCode.OK
    assert len([*unit_of(log).parent.glob("simulshot-*.service")]) == 2
