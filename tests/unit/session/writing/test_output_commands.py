"""The commands of sessions write their folders whole, and mention what a killed one left."""

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.session.reading.reader import Session
from tests.unit.session.writing.outputs import names, opened


def test_sessions_list_mentions_leftovers_and_repair_removes_them(
    session: Session, tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    hidden = tmp_path / ".rendered.part"
    shutil.copytree(session.folder, hidden / "earlier")
    (hidden / "new").mkdir()
    (hidden / "lock").touch()
    assert run(["sessions", "list", str(tmp_path)]) == ExitCode.OK
    assert f"{tmp_path / 'rendered'} is incomplete: if no command is writing it" in capsys.readouterr().err
    assert run(["sessions", "repair", str(tmp_path), "--wait-s", "0"]) == ExitCode.OK
    assert f"restored the earlier result in {tmp_path / 'rendered'}" in caplog.text
    assert names(tmp_path) == ["rendered", "small"]
    assert run(["sessions", "list", str(tmp_path)]) == ExitCode.OK
    assert capsys.readouterr().err == ""


def recording(folder: Path) -> list[str]:
    (folder / "camera").mkdir()
    cv2.imwrite(str(folder / "camera" / "1.png"), np.zeros((8, 8, 3), np.uint8))
    return ["import", f"a={folder / 'camera'}", "--fps", "9", "--name", "out", "--out", str(folder)]


def export(folder: Path) -> list[str]:
    return ["export", str(folder / "small"), "--to", "colmap", "--out", str(folder / "out")]


@pytest.mark.parametrize("command", [recording, export])
def test_each_command_writes_its_folder_so(
    session: Session, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: Callable[[Path], list[str]]
) -> None:
    arguments = ["sessions", *command(tmp_path)]
    with opened(tmp_path / "out") as output:
        output.discard()
        assert run(arguments) == ExitCode.BAD_INPUT
        assert "another run is writing to" in capsys.readouterr().err
    assert run(arguments) == ExitCode.OK
    assert (tmp_path / "out").is_dir()
    assert not list(tmp_path.glob(".*"))
