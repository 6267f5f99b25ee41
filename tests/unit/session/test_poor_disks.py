"""File systems that lack something: virtual machines' shared folders, CIFS, NFS without lockd, Android's."""

import errno
import fcntl
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from capture_app.cli import run
from capture_app.common.errors import ExitCode, TryAgainError
from capture_app.machine.doctor import disk
from capture_app.session.files.abilities import missing_abilities
from capture_app.session.files.durable import AppendOnlyFile
from capture_app.session.files.locks import lock_file, lock_folder
from capture_app.session.library.changes import rename_session, set_note, trash_session
from capture_app.session.reading.reader import Session, is_being_written
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.trust.identity import load_identity
from tests.unit.session.conftest import fill

Lack = Callable[..., None]
CODES = {"fsync": errno.EINVAL, "flock": errno.ENOLCK, "link": errno.EPERM, "chmod": errno.EPERM}


@pytest.fixture(params=[*CODES, "all"])
def lacking(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Let the calls of a file system fail as one does that lacks them; of fsync those of folders."""
    lacks = {*CODES} if request.param == "all" else {request.param}

    def failing(name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*words: Any, **named: Any) -> Any:
            if name != "fsync" or Path(f"/proc/self/fd/{words[0]}").is_dir():
                raise OSError(CODES[name], os.strerror(CODES[name]))
            return real(*words, **named)

        return call

    for name in lacks:
        module = fcntl if name == "flock" else os
        monkeypatch.setattr(module, name, failing(name, getattr(module, name)))
    return lacks


def test_each_lack_is_named_with_what_follows(lacking: set[str], tmp_path: Path) -> None:
    words = {"fsync": "power cut", "flock": "one machine", "link": "copies its images", "chmod": "everybody"}
    lines = missing_abilities(tmp_path)
    assert len(lines) == len(lacking)
    assert all(any(words[lack] in line for line in lines) for lack in lacking)
    assert not list(tmp_path.iterdir())
    finding = disk(tmp_path, "sessions", "--sessions", 1 << 20)
    assert finding.grade == "warning"
    assert all(line in finding.text for line in lines)


def test_a_session_is_written_changed_and_trashed(lacking: set[str], tmp_path: Path) -> None:
    folder = tmp_path / "sessions"
    folder.mkdir()
    session = fill(SessionWriter.create(folder, "clap"))
    set_note(session.folder, "kept")
    renamed = rename_session(session.folder, "an other")
    assert renamed.name == "an-other"
    assert Session.open(renamed).manifest.note == "kept"
    assert run(["sessions", "verify", str(renamed)]) == ExitCode.OK
    trash_session(renamed)
    assert not renamed.exists()


def test_a_lock_keeps_out_the_other_processes_of_this_machine(lacking: set[str], tmp_path: Path) -> None:
    lock = lock_folder(tmp_path)
    assert is_being_written(tmp_path)
    with pytest.raises(TryAgainError, match="being written by another process"):
        lock_folder(tmp_path)
    os.close(lock)
    assert not is_being_written(tmp_path)
    held = lock_file(tmp_path / "lock")
    with pytest.raises(BlockingIOError):
        lock_file(tmp_path / "lock")
    os.close(held)
    os.close(lock_file(tmp_path / "lock", wait=True))


def test_a_machine_has_its_key(lacking: set[str], tmp_path: Path) -> None:
    assert load_identity(tmp_path / "trust").pin == load_identity(tmp_path / "trust").pin


def test_a_line_that_a_failing_disk_neither_took_nor_removed_is_removed_before_the_next(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Else a reader finds a torn line in the middle, or two lines of one image."""

    def fail(*_: Any) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    file = AppendOnlyFile(tmp_path / "lines")
    file.append(b"first", durable=True)
    with monkeypatch.context() as failing:
        failing.setattr(os, "fdatasync", fail)
        failing.setattr(os, "fsync", fail)
        failing.setattr(os, "ftruncate", fail)
        with pytest.raises(OSError, match=os.strerror(errno.EIO)):
            file.append(b"second", durable=True)
    file.append(b"third", durable=True)
    file.close()
    assert (tmp_path / "lines").read_bytes() == b"first\nthird\n"
