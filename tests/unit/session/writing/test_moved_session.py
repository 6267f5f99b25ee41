"""A session that a person renames or moves while it is written goes on at its new place."""

import os
from pathlib import Path

import pytest

from capture_app.common.errors import DiskError, TryAgainError
from capture_app.session.files.locks import lock_folder
from capture_app.session.reading.reader import writing_state
from capture_app.session.reading.verify import verify
from capture_app.session.writing.session_writer import SessionWriter
from tests.unit.session.recorded import frame, record, save_frames

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Windows renames no folder in which files are open")


def test_a_recording_goes_on_where_its_folder_is_moved_to(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path / "sessions", "walk")
    save_frames(writer, frame("left", 0))
    (tmp_path / "disk").mkdir()
    writer.folder.rename(tmp_path / "disk" / "walk of Ada")
    assert writing_state(tmp_path / "disk" / "walk of Ada") == "being written"
    session = record(writer)
    assert session.folder == tmp_path / "disk" / "walk of Ada"
    assert verify(session) == []
    assert len(session.manifest.images) == 5
    assert not [*(tmp_path / "sessions").iterdir()]
    os.close(lock_folder(session.folder))


def test_images_of_a_burst_are_saved_in_a_renamed_folder(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "walk")
    writer.save([frame("left", 0)])
    assert writer.moved_to is None
    writer.folder.rename(tmp_path / "jump")
    writer.save([frame("left", 1), frame("right", 0)])
    assert writer.moved_to == tmp_path / "jump"
    assert (tmp_path / "jump" / "images" / "rig1" / "right" / "000000.jpg").is_file()
    writer.abort()
    assert len(SessionWriter(tmp_path / "jump", "walk").images.records) == 3


def test_what_a_rename_meets_half_written_is_asked_for_again(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "walk")
    with pytest.raises(TryAgainError, match="renamed"), writer._held.writing():
        (writer.folder.rename(tmp_path / "jump") / "lost").unlink()
    with pytest.raises(DiskError), writer._held.writing():
        raise FileNotFoundError
    writer.abort()


def test_another_session_may_take_its_old_name(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "walk")
    save_frames(writer, frame("left", 0))
    writer.folder.rename(tmp_path / "first")
    other = SessionWriter.create(tmp_path, "walk")
    save_frames(other, frame("left", 0))
    assert (record(writer).folder, record(other).folder) == (tmp_path / "first", tmp_path / "walk")


def test_a_deleted_folder_is_a_disk_error(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "walk")
    writer.append([frame("left", 0)], in_videos=True)
    for path in sorted(writer.folder.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    writer.folder.rmdir()
    with pytest.raises(DiskError):
        writer.sync("left")
    assert not writer.videos.has("left", 0)
    writer.abort()
