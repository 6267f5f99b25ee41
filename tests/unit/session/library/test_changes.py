"""A session's name and note change; nothing else of it does."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from capture_app.common.errors import BadInputError, IncompleteError, TryAgainError
from capture_app.session.format.burst_plan import BurstPlan, CameraPlan, read_plan
from capture_app.session.format.manifest import MANIFEST, BurstRecord, MissingImage
from capture_app.session.library.changes import MAX_NOTE, rename_session, results_folder, set_note
from capture_app.session.reading.reader import Session
from capture_app.session.reading.verify import verify
from capture_app.session.writing.session_writer import SessionWriter
from tests.unit.session.conftest import INSTANTS, camera_record, edit_manifest, jpeg

BURST = BurstRecord(instants_ns=INSTANTS[:2], period_ns=33_000_000)


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_renamed_session_is_the_same_but_for_its_name(session: Session, tmp_path: Path) -> None:
    before = content(session.folder)
    (results_folder(session.folder) / "compare").mkdir(parents=True)
    new = rename_session(session.folder, "second-jump")
    assert new == tmp_path / "second-jump"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["_results", "second-jump"]
    opened = Session.open(new)
    assert opened.name == "second-jump"
    assert verify(opened) == []
    changed = {name for name, data in content(new).items() if before.get(name) != data}
    assert changed == {MANIFEST, "checksums.sha256"}
    assert (results_folder(new) / "compare").is_dir()


def test_a_folder_that_was_renamed_by_hand_gives_its_session_that_name(
    session: Session, tmp_path: Path
) -> None:
    moved = session.folder.rename(tmp_path / "jump")
    assert rename_session(moved, "jump") == moved
    assert Session.open(moved).name == "jump"


@pytest.mark.parametrize("name", ["", "..", "a/b", "-x", "x" * 65, "\x1b[2J", "[red]"])
def test_an_unsafe_name_is_refused(session: Session, name: str) -> None:
    with pytest.raises(BadInputError, match="not a valid name"):
        rename_session(session.folder, name)
    assert Session.open(session.folder).name == "small"


def test_a_name_in_use_is_refused(session: Session, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    before = content(session.folder)
    with pytest.raises(BadInputError, match="exists already"):
        rename_session(session.folder, "empty")
    assert content(session.folder) == before


def test_a_note_is_kept_and_can_be_removed(session: Session) -> None:
    for note in ("[b]markup[/b] is text; so is ünï", ""):
        set_note(session.folder, note)
        opened = Session.open(session.folder)
        assert opened.manifest.note == note
        assert verify(opened) == []


def test_a_note_is_one_line_of_text(session: Session) -> None:
    for note in ("two\nlines", "\x1b[2J", "\u2028"):
        with pytest.raises(BadInputError, match="one line"):
            set_note(session.folder, note)
    with pytest.raises(BadInputError, match="at most"):
        set_note(session.folder, "x" * (MAX_NOTE + 1))


def test_a_session_that_is_written_or_interrupted_is_left_alone(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "open")
    writer.add_image(jpeg(1), camera="left", instant=0, leader_ns=5)
    changes: tuple[Callable[[], object], ...] = (
        lambda: rename_session(writer.folder, "new"),
        lambda: set_note(writer.folder, "x"),
    )
    for change in changes:
        with pytest.raises(IncompleteError, match="still being written"):
            change()
    writer.abort()
    with pytest.raises(IncompleteError, match="sessions repair"):
        rename_session(writer.folder, "new")
    assert [path.name for path in tmp_path.iterdir()] == ["open"]


def test_a_session_that_late_images_are_added_to_is_left_alone(tmp_path: Path) -> None:
    folder = burst(tmp_path)
    with SessionWriter.resume(folder), pytest.raises(TryAgainError, match="another process"):
        rename_session(folder, "new")
    assert [path.name for path in tmp_path.iterdir()] == ["take"]


def test_late_images_leave_the_new_name_and_the_note(tmp_path: Path) -> None:
    folder = rename_session(burst(tmp_path), "new")
    set_note(folder, "the best one")
    plan = read_plan(folder)
    assert (plan.name, plan.note) == ("new", "the best one"), "for a repair without a manifest"
    with SessionWriter.resume(folder) as writer:
        writer.add_image(jpeg(2), camera="left", instant=1, leader_ns=INSTANTS[1])
        finish(writer)
    opened = Session.open(folder)
    assert (opened.name, opened.manifest.note, len(opened.manifest.images)) == ("new", "the best one", 2)
    assert verify(opened) == []


def test_a_manifest_that_was_edited_by_hand_is_not_vouched_for(session: Session) -> None:
    edit_manifest(session, lambda content: content.update(origin="imported"))
    with pytest.raises(BadInputError, match=r"changed since it was saved.*sessions repair"):
        set_note(session.folder, "x")
    assert json.loads((session.folder / MANIFEST).read_text())["origin"] == "imported"


def test_a_session_without_checksums_gets_none(session: Session) -> None:
    (session.folder / "checksums.sha256").unlink()
    set_note(session.folder, "by hand")
    assert Session.open(session.folder).manifest.note == "by hand"
    assert not (session.folder / "checksums.sha256").exists()


def burst(root: Path) -> Path:
    """A session of a burst with two instants, which has the first image only."""
    writer = SessionWriter.create(root, "take")
    camera = CameraPlan(camera=camera_record("left"))
    writer.set_plan(
        BurstPlan(
            name="take",
            created=writer.created,
            software=writer.software,
            leader=1,
            number=1,
            burst=BURST,
            cameras=(camera,),
        )
    )
    writer.add_image(jpeg(1), camera="left", instant=0, leader_ns=INSTANTS[0])
    return finish(writer).folder


def finish(writer: SessionWriter) -> Session:
    gap = MissingImage(camera="left", instant=1, reason="the node left")
    return writer.finish([camera_record("left")], BURST, [gap])
