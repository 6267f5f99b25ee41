"""Sessions go to the trash, come back from it, and are gone for good only when it is emptied."""

from pathlib import Path

import pytest

from capture_app.common.errors import BadInputError, DiskError, TryAgainError
from capture_app.session.library.changes import (
    TRASH,
    empty_trash,
    restore_session,
    results_folder,
    trash_session,
    trashed_sessions,
)
from capture_app.session.library.listing import list_sessions
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from capture_app.session.writing.session_writer import SessionWriter
from tests.unit.session.conftest import fill, jpeg


def test_trash_and_back(session: Session, tmp_path: Path) -> None:
    report = results_folder(session.folder) / "compare" / "report.html"
    report.parent.mkdir(parents=True)
    report.write_text("found")
    trashed = trash_session(session.folder)
    assert list_sessions(tmp_path) == []
    assert not results_folder(session.folder).exists()
    assert trashed_sessions(tmp_path) == [trashed]
    assert restore_session(tmp_path) == session.folder
    assert verify(Session.open(session.folder)) == []
    assert report.read_text() == "found"
    assert trashed_sessions(tmp_path) == []


def test_what_cannot_be_restored_stays_in_the_trash(session: Session, tmp_path: Path) -> None:
    trash_session(session.folder)
    fill(SessionWriter.create(tmp_path, "small"))
    with pytest.raises(BadInputError, match=r"exists already.*--as"):
        restore_session(tmp_path)
    with pytest.raises(BadInputError, match="no session other"):
        restore_session(tmp_path, "other")
    assert len(trashed_sessions(tmp_path)) == 1


def test_an_interrupted_session_can_be_thrown_away_but_not_one_being_written(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "take")
    writer.add_image(jpeg(1), camera="left", instant=0, leader_ns=5)
    with pytest.raises(TryAgainError, match="being written"):
        trash_session(writer.folder)
    writer.abort()
    trash_session(writer.folder)
    assert restore_session(tmp_path) == writer.folder


def test_other_folders_are_not_thrown_away(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    with pytest.raises(BadInputError, match="no session at"):
        trash_session(tmp_path / "thesis")


def test_empty(session: Session, tmp_path: Path) -> None:
    assert empty_trash(tmp_path) == 0
    trash_session(session.folder)
    assert empty_trash(tmp_path) == 1
    with pytest.raises(BadInputError, match="is empty"):
        restore_session(tmp_path)


def test_a_record_from_elsewhere_leads_nowhere_else(session: Session, tmp_path: Path) -> None:
    trashed = trash_session(session.folder)
    record = tmp_path / ".trash" / trashed.id / "trashed.json"
    record.write_text('{"id": "../x", "name": "../../outside", "trashed": "2026"}')
    assert restore_session(tmp_path) == tmp_path / "outside"
    trash_session(tmp_path / "outside")
    (tmp_path / ".trash" / "outside" / "trashed.json").write_text("torn")
    assert restore_session(tmp_path) == tmp_path / "outside"


def test_a_trash_that_is_a_link_is_left_alone_and_the_reason_is_given(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (tmp_path / TRASH).symlink_to(elsewhere)
    with pytest.raises(DiskError, match="symbolic link"):
        empty_trash(tmp_path)
    assert elsewhere.is_dir()
