"""`capture-app sessions` rename, note, trash, restore, empty-trash."""

import json
from pathlib import Path
from typing import Any

import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode
from capture_app.session.reading.reader import Session

Capture = pytest.CaptureFixture[str]


def answer(capsys: Capture, *arguments: str) -> dict[str, Any]:
    assert run(["sessions", *arguments, "--json"]) == 0
    answered: dict[str, Any] = json.loads(capsys.readouterr().out)
    return answered


def test_from_name_to_trash_and_back(session: Session, tmp_path: Path, capsys: Capture) -> None:
    new = str(tmp_path / "new")
    assert answer(capsys, "rename", str(session.folder), "new") == {
        "session": new,
        "before": str(session.folder),
    }
    assert answer(capsys, "note", new, "a note") == {"session": new, "note": "a note"}
    assert run(["sessions", "show", new]) == 0
    assert "a note" in capsys.readouterr().out
    assert answer(capsys, "trash", new) == {"trashed": [{"session": new, "id": "new"}]}
    (entry,) = answer(capsys, "list", "--trash", str(tmp_path))["trash"]
    assert entry["name"] == "new"
    assert answer(capsys, "restore", new) == {"session": new}
    assert answer(capsys, "trash", new)["trashed"]
    assert answer(capsys, "restore", str(tmp_path), "--as", "other")["session"] == str(tmp_path / "other")
    assert answer(capsys, "list", str(tmp_path))["sessions"][0]["name"] == "other"


def test_mistakes_are_one_line(session: Session, tmp_path: Path, capsys: Capture) -> None:
    for arguments, reason in (
        (("rename", str(session.folder), "a/b"), "not a valid name"),
        (("rename", str(tmp_path / "nowhere"), "b"), "no session at"),
        (("note", str(session.folder), "a\nb"), "one line"),
        (("trash", str(tmp_path)), "no session at"),
        (("restore", str(session.folder)), "is empty"),
        (("restore", str(tmp_path), "--as", ".."), "is empty"),
    ):
        code = run(["sessions", *arguments])
        error = capsys.readouterr().err
        assert code == ExitCode.BAD_INPUT, error
        assert reason in error or "no session" in error
        assert len(error.splitlines()) == 1


def test_the_trash_is_not_emptied_without_a_yes(session: Session, tmp_path: Path, capsys: Capture) -> None:
    assert run(["sessions", "trash", str(session.folder)]) == 0
    assert "sessions restore" in capsys.readouterr().out
    assert run(["sessions", "empty-trash", str(tmp_path)]) == ExitCode.NOT_AVAILABLE
    assert "--yes" in capsys.readouterr().err
    assert (tmp_path / ".trash" / "small" / "session").is_dir()
    assert answer(capsys, "empty-trash", str(tmp_path), "--yes")["deleted"] == 1
    assert run(["sessions", "list", "--trash", str(tmp_path)]) == 0
    assert "is empty" in capsys.readouterr().err
